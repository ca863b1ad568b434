//! The simulator: world, vehicle, LiDAR and MAVLink endpoint in one clock.
