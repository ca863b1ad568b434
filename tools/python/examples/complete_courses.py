"""Completion of 6 courses by the whole stack, unattacked and attacked. About ten seconds."""

from vigil.evaluate import completion

for name, options in [("unattacked", {}), ("attacked", {"attack": "bim-accumulating", "iterations": 10})]:
    flown = completion("validation", 6, first_seed=1_000_000, **options)
    low, high = flown.interval_95()
    print(f"{name}: {flown.completed} of {len(flown.flights)} ({100 * low:.0f} to {100 * high:.0f} %), {dict(flown.counts())}")
