"""Reads a recording with LeRobot's own reader (lerobot with its extra `dataset`). Prints JSON.

python read_in_lerobot_dataset.py FOLDER
"""

import json
import sys

from lerobot.datasets.lerobot_dataset import LeRobotDataset

found = LeRobotDataset(
    "owner/clutter",
    root=sys.argv[1],
    video_backend="pyav",
    delta_timestamps={"action": [0.0, 0.05]},
)
frames = [found[number] for number in range(len(found))]
first = frames[0]
last = frames[-1]
told = {
    "episodes": found.num_episodes,
    "frames": found.num_frames,
    "fps": found.fps,
    "task": first["task"],
    "shapes": {key: list(value.shape) for key, value in first.items() if hasattr(value, "shape")},
    "timestamp": float(last["timestamp"]),
    "success": bool(last["next.success"]),
    "bright": {
        key: sum(float(each[key].mean()) for each in frames) / len(frames)
        for key in found.meta.video_keys
    },
    "mean": {key: found.meta.stats[key]["mean"].ravel().tolist() for key in found.meta.features},
    "numbers": [each["number"] for each in found.meta.episodes],
}
print(json.dumps(told))
