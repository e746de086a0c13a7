"""Vectorizing as a mosaic of tiles; not in use yet (it shall replace the vectorizer beside it)."""
