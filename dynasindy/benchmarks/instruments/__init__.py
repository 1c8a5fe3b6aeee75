"""What benchmarks measure with: stopwatches, and sensors that are not exact."""
