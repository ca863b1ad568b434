"""Vigil from Python (docs/python.md).

========================  ==========================================================================
:mod:`vigil.gym`          a Gymnasium environment over the simulator, single and vectorised
:mod:`vigil.sb3`          the vectorised one as a ``VecEnv`` of Stable-Baselines3
:mod:`vigil.policy`       the frozen actor and imported policies, deciding on frames
:mod:`vigil.explain`      DeepSHAP of the actor and of imported policies
:mod:`vigil.attack`       FGSM, BIM, PGD and others on what a policy sees
:mod:`vigil.detect`       LSTM-AD: the frozen one, the monitor of the tick, training on any rows
:mod:`vigil.log`          a flight log as arrays, or as a table of pandas
:mod:`vigil.evaluate`     courses completed by the whole stack
========================  ==========================================================================

Frames are depth images of 128 × 256 pixels, ``float32``, ranges in metres from 0 to 100 (nothing in sight: 100), rows from top to
bottom, columns from left to right, 120° × 60°. A goal is ``(distance in metres, bearing in radians, clockwise)``. An action is
``(forward speed in m/s, yaw in units of 30 °/s, clockwise)``, each in ±1.5.
"""

from vigil._vigil import VERSION as VERSION

__version__: str = VERSION
