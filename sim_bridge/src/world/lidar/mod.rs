//! A scanning LiDAR with 64 rings and the depth image made of its point cloud.

mod beams;
mod cast;
mod image;
mod leaf;
mod noise;
mod scene;
mod simd;
mod tiles;
mod triangles;
mod zones;

pub use beams::{LIDAR_BEAMS, LIDAR_FIRINGS, LIDAR_RINGS, beam_direction_frd, ring_row};
pub use cast::Ranges;
pub use noise::split_mix;
pub(crate) use zones::ZoneSensor;

use crate::world::World;
use beams::BeamTable;
use cast::TileCaster;
use noise::NoiseKeys;
use scene::Scene;
use simd::Simd;
use vigil_types::settings::{Outside, within};
use vigil_types::{
    Attitude, DEPTH_COLS, DEPTH_PIXELS, DEPTH_ROWS, DepthFrame, FrameHeader, Nanos, NedVector, settings,
};

settings! {
    /// The sensor's properties. Field of view and resolution are fixed, since the policy's input depends on them (`vigil-types`).
    #[derive(Copy)]
    pub struct LidarConfig {
        /// Standard deviation of a range measurement in metres; 0.02 is typical of automotive sensors.
        pub range_noise_sigma_m: f32 = within(0.02, (0.0, 10.0), "m"),
        /// Share of beams that lose their return, 0 to 1.
        pub dropout_probability: f32 = within(0.01, (0.0, 1.0), ""),
        /// Nothing further away gives a return.
        pub max_range_m: f32 = within(60.0, (1.0, 100.0), "m"),
        /// Surfaces nearer than this are measured at this range.
        pub min_range_m: f32 = within(0.1, (0.01, 1.0), "m"),
        /// Neighbouring beams whose ranges differ by no more than this see one surface.
        pub surface_tolerance_m: f32 = within(0.2, (0.0, 10.0), "m"),
    }
}

/// A value of a [`LidarConfig`] that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("lidar: {0}")]
pub struct LidarConfigError(#[from] Outside);

impl LidarConfig {
    /// A sensor without noise and dropouts.
    pub fn ideal() -> Self {
        Self {
            range_noise_sigma_m: 0.0,
            dropout_probability: 0.0,
            ..Self::default()
        }
    }
}

/// Where and when a frame is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shot {
    /// Where the sensor is.
    pub position_ned_m: NedVector,
    /// How the sensor is turned.
    pub attitude: Attitude,
    /// Where the vehicle believes it is; goes into the frame's header.
    pub estimated_position_ned_m: NedVector,
    /// How the vehicle believes it is turned; goes into the frame's header.
    pub estimated_attitude: Attitude,
    /// Time of capture.
    pub stamp_ns: Nanos,
    /// Number of the frame; the noise depends on it.
    pub sequence: u64,
    /// The sensor's number.
    pub sensor_id: u32,
}

impl Shot {
    /// Taken by a sensor of number 0 whose vehicle knows where it is, the first frame at time 0.
    pub fn at(position_ned_m: NedVector, attitude: Attitude) -> Self {
        Self {
            position_ned_m,
            attitude,
            estimated_position_ned_m: position_ned_m,
            estimated_attitude: attitude,
            stamp_ns: 0,
            sequence: 0,
            sensor_id: 0,
        }
    }
}

/// The sensor. It keeps its working storage; a capture allocates nothing once the largest world was seen.
pub struct Lidar {
    config: LidarConfig,
    seed: u64,
    simd: Simd,
    beams: BeamTable,
    scene: Scene,
    caster: TileCaster,
    ranges: Box<Ranges>,
    inverse: Box<Ranges>,
    filled: Box<Ranges>,
    every: usize,
}

impl Lidar {
    /// What [`every`](Self::every) may be.
    pub const EVERY: [usize; 4] = [1, 2, 4, 8];

    /// A sensor; the seed fixes its noise.
    ///
    /// # Errors
    /// [`LidarConfigError`] names the field that is out of range.
    pub fn new(config: LidarConfig, seed: u64) -> Result<Self, LidarConfigError> {
        settings::check(&config)?;
        let buffer = || Box::new([0.0; LIDAR_BEAMS]);
        Ok(Self {
            config,
            seed,
            simd: Simd::best(),
            every: 1,
            beams: BeamTable::new(1),
            scene: Scene::default(),
            caster: TileCaster::new(1),
            ranges: buffer(),
            inverse: buffer(),
            filled: buffer(),
        })
    }

    /// The same sensor with one ring and one firing of `every` only, for pictures that are cheap ([`look`](Self::look)).
    ///
    /// # Panics
    /// A number that is not in [`EVERY`](Self::EVERY).
    pub fn every(mut self, every: usize) -> Self {
        assert!(Self::EVERY.contains(&every), "every: one of {:?}", Self::EVERY);
        (self.every, self.beams, self.caster) = (every, BeamTable::new(every), TileCaster::new(every));
        self
    }

    /// Rows and columns of a [`look`](Self::look): those of a depth frame, or a row a ring and a column a firing of a thinned sensor.
    pub fn shape(&self) -> [usize; 2] {
        Self::shape_of(self.every)
    }

    /// The shape of a sensor thinned to one of `every`.
    pub fn shape_of(every: usize) -> [usize; 2] {
        match every {
            1 => [DEPTH_ROWS, DEPTH_COLS],
            _ => [LIDAR_RINGS / every, LIDAR_FIRINGS / every],
        }
    }

    /// Takes a frame: ranges, noise, image, header, checksum.
    pub fn capture(&mut self, world: &World, shot: &Shot, frame: &mut DepthFrame) {
        self.cast(world, shot.position_ned_m, shot.attitude);
        self.measure(shot.sequence);
        self.project(frame);
        frame.header = FrameHeader {
            stamp_ns: shot.stamp_ns,
            sequence: shot.sequence,
            sensor_id: shot.sensor_id,
            rows: DEPTH_ROWS as u16,
            cols: DEPTH_COLS as u16,
            position_ned_m: shot.estimated_position_ned_m,
            attitude: shot.estimated_attitude,
            ..FrameHeader::default()
        };
        frame.seal();
    }

    /// Takes a frame's pixels alone, times `scale`, for the vehicle whose noise has this seed: one sensor serves many vehicles, and nothing is
    /// copied or summed up. A thinned sensor's pixels are its beams as they are, gaps and all.
    ///
    /// # Panics
    /// Pixels of another number than [`shape`](Self::shape) has.
    pub fn look(&mut self, world: &World, shot: &Shot, seed: u64, scale: f32, pixels: &mut [f32]) {
        self.seed = seed;
        self.cast(world, shot.position_ned_m, shot.attitude);
        self.measure(shot.sequence);
        if self.every == 1 {
            return self.image(scale, pixels.try_into().expect("a frame's pixels"));
        }
        let beams = self.beams.rings * self.beams.firings;
        assert_eq!(pixels.len(), beams, "a thinned frame's pixels");
        for (pixel, inverse) in pixels.iter_mut().zip(self.inverse.iter()) {
            *pixel = scale * image::normalised(*inverse);
        }
    }

    /// First stage of a capture: the true range along every beam, infinite where there is nothing.
    pub fn cast(&mut self, world: &World, position_ned_m: NedVector, attitude: Attitude) -> &Ranges {
        self.scene.place(world, position_ned_m, attitude);
        let (caster, beams) = (&mut self.caster, &self.beams);
        cast::cast(self.simd, caster, &self.scene, beams, &mut self.ranges);
        &self.ranges
    }

    /// Second stage: noise, limits and dropouts on the ranges of the last [`cast`](Self::cast).
    pub fn measure(&mut self, sequence: u64) {
        let keys = NoiseKeys::new(self.seed, sequence);
        let beams = self.beams.rings * self.beams.firings;
        let inverse = &mut self.inverse[..beams];
        noise::measure(self.simd, &self.config, keys, &self.ranges[..beams], inverse);
    }

    /// Third stage: the image of what was last measured. The header is left as it is.
    pub fn project(&mut self, frame: &mut DepthFrame) {
        self.image(1.0, &mut frame.depth);
    }

    fn image(&mut self, scale: f32, pixels: &mut [f32; DEPTH_PIXELS]) {
        let tolerance_m = self.config.surface_tolerance_m;
        image::image(self.simd, tolerance_m, scale, &self.inverse, &mut self.filled, pixels);
    }
}

#[cfg(test)]
mod tests;
