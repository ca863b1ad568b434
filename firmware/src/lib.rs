//! The 20 Hz rate loop, its wiring, and the firmware program.
