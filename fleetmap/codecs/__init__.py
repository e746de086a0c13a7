"""Vector map to bytes and back."""
