"""The fold: from all replicas to the merged map."""
