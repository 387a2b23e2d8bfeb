"""A trajectory as a table with the columns of the trajectory CSV."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bodycheck.reference_impl.trajectory import Trajectory

if TYPE_CHECKING:
    import pandas as pd


def trajectory_table(trajectory: Trajectory) -> pd.DataFrame:
    """Return t_s, x_m, ..., qw, ..., wz_body_rad_s, one row a sample; omega in both axes."""
    import pandas as pd

    columns = {"t_s": trajectory.t_s}
    groups = (
        (("x_m", "y_m", "z_m"), trajectory.position_m),
        (("qw", "qx", "qy", "qz"), trajectory.attitude),
        (("vx_m_s", "vy_m_s", "vz_m_s"), trajectory.velocity_m_s),
        (("wx_world_rad_s", "wy_world_rad_s", "wz_world_rad_s"), trajectory.omega_world),
        (("wx_body_rad_s", "wy_body_rad_s", "wz_body_rad_s"), trajectory.omega_body),
    )
    for names, values in groups:
        columns |= {name: values[:, i] for i, name in enumerate(names)}
    return pd.DataFrame(columns)
