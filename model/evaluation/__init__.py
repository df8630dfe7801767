"""Part matching, joint metrics, executability, reports and benchmarks."""
