"""What benchmarks measure with: stopwatches, sensors that are not exact, flights elsewhere, the commit."""
