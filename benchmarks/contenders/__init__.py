"""What is measured side by side, one contender a file."""
