//! Courses, ray casting, collision and the LiDAR that looks at them.
