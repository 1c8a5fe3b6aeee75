"""From a log to a judged model: the fit, forecasts beside simple models, and findings."""
