"""The paper's table "SINDY model Xi matrix": its 19 coefficients, a column per rate of change."""

TABLE = {
    "1": (0, 0, 0, 0.5961, 262.7, -8.54),
    "Omega_a": (1, 0, -10.0573, 0, 0, 0),
    "Omega_p": (0, 1, 0, -0.414, 0, 0),
    "omega_a": (0, 0, 0, 0, -5.2281, 0),
    "omega_p": (0, 0, 0, 0.0013, 0, -1.4193),
    "u_a": (0, 0, 0, 0.1303, 3.7e4, 0),
    "u_p": (0, 0, 0, 0, 0, 6.1e3),
    "omega_a cos(alpha_p)": (0, 0, 9.8316e-4, 0, 0, 0),
    "u_p cos(alpha_p)": (0, 0, -0.7025, 0, 0, 0),
    "Omega_a^2 sin(alpha_p)": (0, 0, 0, -16.3547, 0, 0),
    "sin(alpha_p)": (0, 0, 0, -3.54373, 0, 0),
    "cos(alpha_p)": (0, 0, 0.9479, -1.7473, 0, 0),
}
"""Of the states alpha_a, alpha_p, Omega_a, Omega_p, omega_a and omega_p."""
