"""Reports and figures of a run."""
