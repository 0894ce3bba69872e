"""What lies in a report's folder, read back: numbers, trajectories, a pose graph and a map.

python docs/examples/05_read_a_report.py [FOLDER]     without one, a short run makes it
"""

import json
import sys
from pathlib import Path

import numpy as np

from maps.grid import read_map
from station.api import Scenario, run
from station.formats import read_g2o, read_tum

if len(sys.argv) > 1:
    folder = Path(sys.argv[1])
else:
    folder = Path("report")
    run(Scenario(map="rooms-small", seed=5), out=folder)

metrics = json.loads((folder / "metrics.json").read_text())
print(f"{metrics['map']}, seed {metrics['seed']}: {metrics['exit_reason']}")
for name, robot in metrics["robots"].items():
    if robot["ate_rmse_m"] is None:
        print(f"{name}: {robot['note']}")
        continue
    true, online = read_tum(folder / name / "true.tum"), read_tum(folder / name / "online.tum")
    count = min(len(true.poses), len(online.poses))
    apart = online.poses[:count, :2] - true.poses[:count, :2]
    graph = read_g2o(folder / name / "graph.g2o")
    known = read_map(folder / name / "joint_map.yaml")
    print(
        f"{name}: {count} poses, at most {np.hypot(*apart.T).max():.3f} m off; "
        f"{len(graph.nodes)} submaps, {len(graph.edge_nodes)} ties; "
        f"{known.known.sum() * known.resolution**2:.0f} m² known"
    )
