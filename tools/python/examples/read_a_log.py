"""Reads a flight log. `vigil fly --seed 7` leaves one under runs/.

python3 read_a_log.py runs/fly-…/flight-0001.mcap
"""

import sys

import numpy as np

import vigil.log

if len(sys.argv) != 2:
    sys.exit(__doc__)
log = vigil.log.read(sys.argv[1], frames=True)
position = log["position_ned_m"]
print(f"{len(log.step)} steps, {log.time_s[-1]:.1f} s, {len(log.frames)} frames, seed {log.info['seed']}; {log.end}")
flown = np.linalg.norm(np.diff(position, axis=0), axis=1)
scores = log["score"][np.isfinite(log["score"])]
highest = f"{scores.max():.3f}" if len(scores) else "none"
print(f"{np.nansum(flown):.1f} m flown, highest score {highest}, alarms: {', '.join(set(log['alarm']) - {None}) or 'none'}")
try:
    print(log.table()[["goal_0", "action_0", "action_1", "score", "state"]].iloc[::40])
except ImportError as e:
    print(e)
