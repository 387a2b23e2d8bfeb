"""What bodycheck finds in engines and in published models: data, commands that reproduce it, and pages."""
