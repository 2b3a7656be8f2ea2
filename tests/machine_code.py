"""Compiles the simulators and the prediction model into numba's cache.

    python -m tests.machine_code

``make test`` does so before it starts its workers: in a fresh clone each of them, and each process
that they start, would else spend half a minute on the same.
"""

import numpy as np

from flipperctl.api import Profile, Robot


def compile_environment() -> None:
    """Thin a profile, bound a drive, and play a decision with a sensor that casts rays."""
    from benchmarks.statics import static_bound
    from flipperctl.env.flipper_env import FlipperEnv
    from flipperctl.sim.ground import thinned

    thinned(Profile([(0.001 * i, 0.0001 * i) for i in range(2000)]), 0.1)
    static_bound(np.zeros((1, 2)), Robot(), start=0.0, finish=0.1)
    for sim in ("planar", "mujoco"):
        env = FlipperEnv("flat", sim=sim, **{"perception.occlusion": True})
        env.reset(seed=0)
        while not any(env.step(4)[2:4]):  # the measures of an episode are compiled, too
            pass


if __name__ == "__main__":
    from flipperctl.lookahead.model import compile_now

    compile_environment()
    compile_now()
