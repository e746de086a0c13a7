"""Where one map lies in another: hypotheses, and what speaks for and against each. Floats, unlike the fold."""
