"""Running SLAM programs, and benchmarks of them."""
