"""What several test modules and the scripts in tools/ share."""
