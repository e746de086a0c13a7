"""The vocabulary: poses, grids, vector maps, merged maps, metrics, errors."""
