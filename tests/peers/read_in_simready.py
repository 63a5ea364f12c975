"""Validates exported objects by SimReady; needs simready-validate and its core tier. Prints JSON.

python read_in_simready.py EXPORT PROFILE_VERSION...
"""

import json
import logging
import sys
from pathlib import Path

from simready.validate import api

logging.disable(logging.ERROR)
api.initialize([], [], [])
report = {}
for version in sys.argv[2:]:
    for path in sorted(Path(sys.argv[1]).glob("assets/objects/*/usd/*.usda")):
        result = api.validate_asset(api.AssetValidationConfig(str(path), "Robotics-Prop", version))
        report[f"{path.stem} {version}"] = {
            "is_passed": api.features_summary_passed(result.features_summary),
            "issues": [str(issue.message) for issue in result.issues],
            "features": {name: each["passed"] for name, each in result.features_summary.items()},
        }
print(json.dumps(report))
