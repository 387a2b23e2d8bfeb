"""Trees of rigid bodies connected by joints: their description and their exact dynamics."""
