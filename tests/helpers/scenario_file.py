"""A small scenario as a file, and what two runs of it cannot share."""

SCENARIO = """
name = "mine"
duration_s = 1.0
samples = 11
[body]
mass_kg = 1.0
inertia_kg_m2 = [1.0, 2.0, 2.5]
[initial]
omega_body_rad_s = [0.3, 1.0, -0.2]
"""

MEASURED_ANEW = ["run_id", "cpu_s", "cpu_s_low", "cpu_s_high", "ns_per_step", "relative_cpu"]
