//! A PX4-flavoured MAVLink vehicle, sans IO.
