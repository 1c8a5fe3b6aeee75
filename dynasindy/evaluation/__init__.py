"""How good a controller is: metrics, statistics over seeds, scenarios, and what a model says of it before it flies."""
