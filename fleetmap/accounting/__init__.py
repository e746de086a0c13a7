"""Every byte counted."""
