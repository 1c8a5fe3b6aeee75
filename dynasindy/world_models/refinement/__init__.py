"""From a first guess to what the data can tell: one step, whole trajectories, delays, shapes, states unseen."""
