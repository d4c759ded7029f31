"""Semi-global matching, disparity and depth, and their error against truth."""
