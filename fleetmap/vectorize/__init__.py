"""Grid to vector map and back."""
