//! The LiDAR with what fails of it and the key of its frames: a vehicle's depth sensor, ours and others'.

use crate::sensor_fault::{FailingSensor, SensorFault};
use crate::world::{Lidar, LidarConfig, LidarConfigError, Shot, World};
use vigil_types::{DepthFrame, FrameKey, Nanos};

/// The LiDAR's id in frame headers; the one that the firmware accepts by default.
pub const LIDAR_SENSOR_ID: u32 = 1;

pub(crate) struct DepthSensor {
    lidar: Lidar,
    /// Present when it is to fail.
    failing: Option<FailingSensor>,
    /// Present when its driver authenticates its frames.
    frame_key: Option<FrameKey>,
    next_sequence: u64,
}

impl DepthSensor {
    pub(crate) fn new(
        lidar: LidarConfig,
        seed: u64,
        fault: Option<SensorFault>,
        frame_key: Option<FrameKey>,
    ) -> Result<Self, LidarConfigError> {
        Ok(Self {
            lidar: Lidar::new(lidar, seed)?,
            failing: fault.map(|fault| FailingSensor::new(fault, seed)),
            frame_key,
            next_sequence: 0,
        })
    }

    /// Captures a frame `elapsed_ns` after the start, as the fault leaves it, seals it, and authenticates it if there is a key. Sensor's
    /// id, sequence and the attitude of a sensor that is turned on its mount are set here.
    pub(crate) fn capture(&mut self, world: &World, elapsed_ns: Nanos, shot: Shot, frame: &mut DepthFrame) {
        let turned = |failing: &FailingSensor| failing.attitude(elapsed_ns, shot.attitude);
        let shot = Shot {
            attitude: self.failing.as_ref().map_or(shot.attitude, turned),
            sequence: self.next_sequence,
            sensor_id: LIDAR_SENSOR_ID,
            ..shot
        };
        self.lidar.capture(world, &shot, frame);
        if let Some(failing) = &mut self.failing {
            failing.spoil(elapsed_ns, frame);
        }
        if let Some(key) = &self.frame_key {
            frame.authenticate(key);
        }
        self.next_sequence += 1;
    }
}
