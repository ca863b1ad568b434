//! What one simulated flight is made of, and the file that changes the defaults.

use crate::SensorFault;
use crate::vehicle::{ParamsError, VehicleModel, VehicleParams, Wind};
use crate::world::{Course, Family, LONG_GOAL_M, LidarConfig, generate, generate_long};
use anyhow::{Context, Result, bail};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use std::path::{Path, PathBuf};
use vigil_autopilot::{EndpointConfig, Saved};
use vigil_types::settings::{SettingsError, section};
use vigil_types::{FrameKey, settings};

/// Where the vehicle is at time zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Start {
    /// On the ground, disarmed.
    #[default]
    Ground,
    /// Hovering at the course's flight height, armed, in Hold: campaigns begin here.
    Airborne,
}

/// Everything that determines a simulated flight.
#[derive(Debug, Clone)]
pub struct SimConfig {
    /// Obstacles, goal, bounds.
    pub course: Course,
    /// Seed of all noise: LiDAR, sensors, wind.
    pub seed: u64,
    /// On the ground or in the air.
    pub start: Start,
    /// The vehicle's MAVLink side; by default only the guidance computer's link, as in lockstep.
    pub endpoint: EndpointConfig,
    /// The vehicle's parameters and plans of an earlier run.
    pub saved: Saved,
    /// LiDAR model.
    pub lidar: LidarConfig,
    /// What fails of the LiDAR, if anything.
    pub sensor_fault: Option<SensorFault>,
    /// So many small sensors of 45° each beside the LiDAR, side by side, whose ranges the vehicle sends by MAVLink; 0: none.
    pub second_sensor_heads: usize,
    /// The key with which the LiDAR's driver authenticates its frames, if it does.
    pub frame_key: Option<FrameKey>,
    /// Airframe, controllers, sensors, battery.
    pub vehicle: VehicleParams,
    /// Wind and gusts.
    pub wind: Wind,
}

impl SimConfig {
    /// The default models on `course`.
    pub fn new(course: Course, seed: u64) -> Self {
        Self::with_models(course, seed, Models::default())
    }

    /// The given models on `course`.
    pub fn with_models(course: Course, seed: u64, models: Models) -> Self {
        Self {
            course,
            seed,
            start: Start::Ground,
            endpoint: EndpointConfig::companion_only(),
            saved: Saved::default(),
            lidar: models.lidar,
            sensor_fault: None,
            second_sensor_heads: 0,
            frame_key: None,
            vehicle: models.vehicle,
            wind: models.wind,
        }
    }
}

settings! {
    /// The simulation file: one table per model, each with documented defaults (docs/simulation.md). Unknown keys are errors.
    pub struct Models {
        /// LiDAR.
        pub lidar: LidarConfig = section(),
        /// Airframe, controllers, sensors, battery.
        pub vehicle: VehicleParams = section(),
        /// Wind.
        pub wind: Wind = section(),
    }
}

impl Models {
    /// Reads a file, whose vehicle must be one that can be flown.
    fn load(path: &Path) -> Result<Self, SettingsError> {
        let models: Self = settings::load(path)?;
        let refused = |error: ParamsError| SettingsError::Content {
            path: path.to_owned(),
            message: error.to_string(),
        };
        models.vehicle.validate().map_err(refused).map(|()| models)
    }
}

/// Which vehicle flies: shared by all commands that simulate one.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub struct VehicleChoice {
    /// The vehicle and how its autopilot answers (docs/vehicle.md).
    #[arg(long, value_name = "MODEL", value_parser = model_parser(), default_value = VehicleModel::Ours.name())]
    pub vehicle_model: VehicleModel,

    /// Its estimate wanders as one on GPS and barometer does: half a metre, in height up to a metre over minutes. Frames and collisions are
    /// the truth's.
    #[arg(long)]
    pub noisy_estimate: bool,
}

/// Parses the name of a vehicle model; help and errors list all of them.
fn model_parser() -> impl TypedValueParser<Value = VehicleModel> {
    PossibleValuesParser::new(VehicleModel::ALL.map(VehicleModel::name))
        .try_map(|name| VehicleModel::from_name(&name).ok_or("no vehicle model"))
}

impl VehicleChoice {
    /// The models of a simulation file, or the defaults, with this vehicle.
    ///
    /// # Errors
    /// What is wrong with the file; a file that has another vehicle.
    pub fn models(&self, file: Option<&Path>) -> Result<Models> {
        let mut models = file.map(Models::load).transpose()?.unwrap_or_default();
        if self.vehicle_model != VehicleModel::Ours {
            if let Some(file) = file.filter(|_| models.vehicle != VehicleParams::default()) {
                let (model, file) = (self.vehicle_model.name(), file.display());
                bail!("--vehicle-model {model} and {file}, which has a [vehicle] of its own: leave one of them out");
            }
            models.vehicle = self.vehicle_model.params();
        }
        if self.noisy_estimate {
            models.vehicle = models.vehicle.with_noisy_estimate();
        }
        Ok(models)
    }

    /// The same choice for a process that is started: only what differs from the default.
    pub fn hand_on(&self, command: &mut std::process::Command) {
        if self.vehicle_model != VehicleModel::Ours {
            command.args(["--vehicle-model", self.vehicle_model.name()]);
        }
        if self.noisy_estimate {
            command.arg("--noisy-estimate");
        }
    }

    /// The vehicle in words, where it is not the default one.
    pub fn name(&self) -> Option<String> {
        let noisy = if self.noisy_estimate { ", noisy estimate" } else { "" };
        (*self != Self::default()).then(|| format!("{}{noisy}", self.vehicle_model.name()))
    }
}

/// Which course to fly: a file, or a family and a seed. Shared by all commands that need one.
#[derive(Debug, Clone, clap::Args)]
pub struct CourseChoice {
    /// Course file (TOML); see docs/courses.md.
    #[arg(long, value_name = "FILE", conflicts_with = "family")]
    pub course: Option<PathBuf>,

    /// Family of generated courses.
    #[arg(long, value_parser = family_parser(), default_value_t = Family::Validation)]
    pub family: Family,

    /// Make the course this long: a goal 5 to 400 m north, as dense all the way. Not for the hard family.
    #[arg(long, value_name = "M", conflicts_with = "course", value_parser = long_goal)]
    pub goal_distance: Option<f32>,

    /// Seed of course, noise and wind; a random one when absent.
    #[arg(long)]
    pub seed: Option<u64>,
}

/// Parses the distance of a long course's goal, metres.
fn long_goal(text: &str) -> Result<f32, String> {
    let (least, most) = (LONG_GOAL_M.start(), LONG_GOAL_M.end());
    match text.parse() {
        Ok(distance_m) if LONG_GOAL_M.contains(&distance_m) => Ok(distance_m),
        _ => Err(format!("a distance is a number from {least} to {most} metres")),
    }
}

/// Parses a time from 0 on, seconds.
pub(crate) fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|s: &f64| s.is_finite() && *s >= 0.0);
    seconds.ok_or_else(|| "give seconds, 0 or more".to_owned())
}

/// Parses the name of a family of courses; help and errors list all of them.
pub fn family_parser() -> impl TypedValueParser<Value = Family> {
    PossibleValuesParser::new(Family::ALL.map(Family::name)).try_map(|name| name.parse::<Family>())
}

impl CourseChoice {
    /// The seed in force: the one given, or one from the operating system's entropy.
    pub fn seed_or_random(&self) -> u64 {
        use std::hash::{BuildHasher, RandomState};
        self.seed
            .unwrap_or_else(|| RandomState::new().hash_one(0u8) % 1_000_000)
    }

    /// Reads or generates the course for `seed`.
    ///
    /// # Errors
    /// What is wrong, by file, line and field.
    pub fn load(&self, seed: u64) -> Result<Course> {
        match (&self.course, self.goal_distance) {
            (Some(path), _) => Ok(Course::load(path)?),
            (None, Some(distance_m)) => {
                let family = self.family;
                generate_long(family, seed, distance_m).with_context(|| {
                    format!(
                        "--goal-distance: courses of the family {family} cannot be made longer; take another family"
                    )
                })
            }
            (None, None) => Ok(generate(self.family, seed)),
        }
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_vehicle_that_cannot_fly_is_refused_with_its_file() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(&file, "[vehicle.battery]\nempty_v = 500.0").unwrap();
        let error = super::VehicleChoice::default().models(Some(file.path())).unwrap_err();
        let start = format!("{}: vehicle parameter `battery.full_v` is 16.8", file.path().display());
        assert!(error.to_string().starts_with(&start), "{error}");
    }

    #[test]
    fn a_time_without_an_end_and_one_before_the_beginning_are_refused() {
        for text in ["nan", "inf", "-1", "soon"] {
            assert!(super::seconds(text).is_err(), "{text}");
        }
        assert_eq!(super::seconds("0"), Ok(0.0));
    }
}
