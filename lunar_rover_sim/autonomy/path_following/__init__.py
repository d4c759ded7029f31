"""Path following: routes, velocity profiles, pure pursuit, and the reasons to stop."""
