"""Vector maps to bytes and back: payload codecs, messages, files, and the grids that they are compared with."""
