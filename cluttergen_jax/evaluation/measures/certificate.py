"""The stability certificate: what is known of how well a scene stands, in plain numbers."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from cluttergen_jax.config import DETECTORS
from cluttergen_jax.evaluation.measures.contacts import contacts_of
from cluttergen_jax.evaluation.measures.robustness import ShakeConfig, TiltConfig, robust, shake, tilt
from cluttergen_jax.evaluation.measures.scene_models import SceneModels
from cluttergen_jax.evaluation.measures.simulate import each_scene, movement

SUPPORT = -1


def certificates(
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    seconds: float = 2.0,
    shake_config: ShakeConfig | None = None,
    num_threads: int = 0,
) -> list[dict[str, Any]]:
    """One certificate a scene, ready to become a bank's columns.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      seconds: the horizon of drift; by default that of the last check's second stage.

    Returns:
      For each scene
        residual_speed: m/s, the fastest origin after the scene was let go for 0.25 s.
        residual_angular_speed: rad/s, likewise.
        drift, drift_turn: metres and radians, the most that anything was from its start within the horizon,
          with either of MuJoCo's detectors of convex collisions.
        detectors: those with which nothing moved by 5 mm or 5 degrees; all else is measured with native's.
        drift_seconds: the horizon.
        penetration: metres, the deepest overlap of two bodies.
        num_contacts: contact points.
        shake: m/s^2, the smaller of the scores along world x and y (`robustness.shake`).
        shake_x, shake_y: both of them, where these are the directions.
        rests_on: list of (i, j): object i rests on object j; indices of the world's objects, -1 the support.
        margin: metres, the least support margin; None if nothing is carried from below.
        margins: metres, each of the world's K objects'; None where not placed or not carried from below.
        tilt_1, tilt_2, tilt_5: share of directions in which gravity, tilted by so many degrees, topples
          nothing.
        robust: it stands in soft contact, with less friction and gravity tilted (`robustness.robust`).
    """
    models.check(poses, is_placed)
    is_placed, tilt_config = np.asarray(is_placed, bool), TiltConfig()
    contacts = contacts_of(models, poses, is_placed, num_threads)
    drifts = {
        name: movement(models.with_detector(name), poses, is_placed, (seconds,), num_threads)
        for name in DETECTORS
    }
    scores = shake(models, poses, is_placed, shake_config, num_threads)
    speeds = residual_speeds(models, poses, is_placed, num_threads)
    stands = tilt(models, poses, is_placed, tilt_config, num_threads)
    is_robust = robust(models, poses, is_placed, num_threads=num_threads)
    rests_on, margins = contacts.rests_on, [[_finite(each) for each in row] for row in contacts.margin]
    return [
        {
            "residual_speed": float(speeds[n, 0]),
            "residual_angular_speed": float(speeds[n, 1]),
            "drift": max(float(each.largest_shift[n, 0]) for each in drifts.values()),
            "drift_turn": max(float(each.largest_turn[n, 0]) for each in drifts.values()),
            "drift_seconds": float(seconds),
            "penetration": float(contacts.penetration[n]),
            "num_contacts": int(contacts.count[n]),
            "shake": float(scores[n].min()),
            "shake_x": float(scores[n, 0]),
            "shake_y": float(scores[n, -1]),
            "rests_on": support_edges(rests_on[n]),
            "margin": min((each for each in margins[n] if each is not None), default=None),
            "margins": margins[n],
            **{
                f"tilt_{by:g}": float(share) for by, share in zip(tilt_config.degrees, stands[n], strict=True)
            },
            "robust": bool(is_robust[n]),
            "detectors": [name for name, each in drifts.items() if each.survives()[n, 0]],
        }
        for n in range(len(is_placed))
    ]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def support_edges(rests_on: np.ndarray) -> list[tuple[int, int]]:
    """The support graph of one scene, bool[K, K + 1], as pairs (who rests, on whom), -1 for the support."""
    size = rests_on.shape[0]
    return [(int(i), SUPPORT if j == size else int(j)) for i, j in np.argwhere(rests_on)]


def residual_speeds(
    models: SceneModels, poses: np.ndarray, is_placed: np.ndarray, num_threads: int = 0, seconds: float = 0.25
) -> np.ndarray:
    """f64[N, 2]: m/s and rad/s of the fastest object `seconds` after scenes were let go from rest."""
    models.check(poses, is_placed)
    is_placed = np.asarray(is_placed, bool)

    def run(scene: int) -> tuple[float, float]:
        model = models.of(is_placed[scene])
        data = model.start(poses[scene])
        mujoco.mj_step(model.model, data, round(seconds / model.model.opt.timestep))
        velocity = data.qvel.reshape(-1, 2, 3)
        linear, angular = np.linalg.norm(velocity, axis=2).max(0, initial=0.0)
        return float(linear), float(angular)

    return np.array(each_scene(run, len(is_placed), num_threads), np.float64).reshape(-1, 2)
