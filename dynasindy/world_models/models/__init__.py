"""World models, and what is known of each: its report, its spread, how well it predicts."""
