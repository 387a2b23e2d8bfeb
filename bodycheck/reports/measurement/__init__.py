"""What is measured of one case, and what the cases of one method say together."""
