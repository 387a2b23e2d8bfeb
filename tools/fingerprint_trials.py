"""Measure fingerprints and laws of every method of the installed engines, and of releases NAME==VERSION.

Prints the known map of each method, its agreement, the distance of the runner-up relative to it, the largest
ratio of a break to its tolerance over all laws that a method must obey, and the processor time.
"""

from __future__ import annotations

import time

from trials import command

from bodycheck.runs.engine_checks import fingerprints, laws


def main(*engines: str) -> None:
    """Print two lines per method, and one per engine; engines: NAME[==VERSION][:METHOD]."""
    for engine in engines or ("mujoco", "pybullet", "dart", "reference"):
        begin = time.process_time()
        rows = fingerprints(engine, timeout_s=600.0)
        named = time.process_time()
        checked = laws(engine, timeout_s=600.0)
        for row in rows:
            who = f"{row['engine']}:{row['method']}"
            ratio = (row["runner_up_distance"] or 0.0) / (row["agreement"] or 1.0)
            print(f"{who:32s} {row['fingerprint']}, {row['agreement']}, runner-up {ratio:.2g} times farther")
            own = [one for one in checked if one["method"] == row["method"] and one["verdict"] != "property"]
            worst = max((one["size"] / one["tolerance"] for one in own if one.get("tolerance")), default=0.0)
            broken = [one["law"] for one in own if one["verdict"] == "broken"]
            print(f"{'':32s} laws: {worst:.2g} of the tolerance, broken: {', '.join(broken) or 'none'}")
        again = time.process_time() - named
        print(f"{engine}: {named - begin:.1f} s for fingerprints, {again:.1f} s with the laws")


if __name__ == "__main__":
    command(main)
