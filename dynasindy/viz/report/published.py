"""What the paper prints in numbers: its table of hyperparameters and its table of coefficients."""

from __future__ import annotations

from collections.abc import Mapping

HYPERPARAMETERS: tuple[tuple[str, str, float, str], ...] = (
    ("Sampling Time [s]", "t_s", 0.05, "env.dt"),
    ("Maximum Steps per episode", "-", 400, "task.max_steps"),
    ("Critic Learning Rate", "alpha", 1e-4, "agent.critic_lr"),
    ("Actor Learning Rate", "alpha", 1e-4, "agent.actor_lr"),
    ("Discount Factor", "gamma", 0.995, "agent.gamma"),
    ("Buffer Size", "D", 2e6, "replay.capacity"),
    ("Batch Size", "K", 512, "replay.batch_size"),
    ("Noise", "sigma", 0.15, "agent.exploration_noise"),
    ("Noise Decay Rate", "-", 1e-3, "agent.noise_decay"),
    ("Target Smooth Factor", "tau", 0.005, "agent.tau"),
    ("Target Update Frequency", "-", 10, "agent.target_update_interval"),
)
"""Rows of the paper's table "Agent Training Hyperparameters": words, symbol, value, our key."""

XI: Mapping[str, Mapping[str, float]] = {
    "alpha_a": {"Omega_a": 1.0},
    "alpha_p": {"Omega_p": 1.0},
    "Omega_a": {
        "Omega_a": -10.0573,
        "omega_a cos(alpha_p)": 9.8316e-4,
        "u_p cos(alpha_p)": -0.7025,
        "cos(alpha_p)": 0.9479,
    },
    "Omega_p": {
        "1": 0.5961,
        "Omega_p": -0.414,
        "omega_p": 0.0013,
        "u_a": 0.1303,
        "Omega_a^2 sin(alpha_p)": -16.3547,
        "sin(alpha_p)": -3.54373,
        "cos(alpha_p)": -1.7473,
    },
    "omega_a": {"1": 262.7, "omega_a": -5.2281, "u_a": 3.7e4},
    "omega_p": {"1": -8.54, "omega_p": -1.4193, "u_p": 6.1e3},
}
"""Non-zero coefficients of the paper's table "SINDY model Xi matrix", by equation and function."""
