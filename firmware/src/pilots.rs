//! Who flies, and what watches it: made and verified before anything flies.

use alloc::boxed::Box;
use vigil_detector::Monitor;
use vigil_nnet::Isa;
use vigil_nnet::network_file::FileError;
use vigil_policy::{FlightPilot, FrozenPilot, LearnedPilot, RecoveryPilot};
#[cfg(feature = "std")]
use {
    crate::config::FirmwareConfig,
    anyhow::{Result, anyhow, ensure},
    vigil_detector::FrozenDetector,
    vigil_nnet::Purpose,
    vigil_policy::{FrozenActor, GeometricPilot},
    vigil_types::{Ablation, PilotKind},
};

/// Who flies, and what watches it. What watches sees what the actor decided from, and acts on the flight through guidance only.
pub struct Pilots {
    /// Who flies.
    pub pilot: FlightPilot,
    /// The detector: judges each of the actor's decisions. Boxed at start: it is large, and many flights have none.
    pub monitor: Option<Box<Monitor>>,
    /// Plans in every step, so that it remembers what it saw before an alarm. Where something watches, it takes the actor's place while an
    /// alarm is raised, and shows the guard what lies ahead; its path brings an imported policy to a far goal where the line to it leads
    /// nowhere.
    pub recovery: Option<Box<RecoveryPilot>>,
    /// Whether anything watches: without it the recovery pilot leads, but neither flies nor warns.
    pub monitored: bool,
}

impl Pilots {
    /// A pilot that nothing watches.
    pub fn unmonitored(pilot: FlightPilot) -> Self {
        Self {
            pilot,
            monitor: None,
            recovery: None,
            monitored: false,
        }
    }

    /// A learned pilot, alone or monitored by `monitor`, the guard or both; `field` adds the potential field to it.
    ///
    /// # Errors
    /// Parameters of another length.
    pub fn learned(
        isa: Isa,
        frozen: &FrozenPilot,
        field: bool,
        monitor: Option<Box<Monitor>>,
        monitored: bool,
    ) -> Result<Self, FileError> {
        Ok(Self {
            pilot: FlightPilot::Learned(LearnedPilot::new(frozen.decider(isa)?, field)),
            monitor,
            recovery: Some(Box::default()),
            monitored,
        })
    }

    /// The pilots of a configuration.
    ///
    /// # Errors
    /// An actor or a detector that is truncated, altered or of another architecture, a detector for another actor: by name. A
    /// detector or a guard that was asked for where no actor flies.
    #[cfg(feature = "std")]
    pub fn of(config: &FirmwareConfig) -> Result<Self> {
        Self::of_with(config, Isa::detect())
    }

    /// The same with the kernels of an instruction set.
    ///
    /// # Errors
    /// As [`Self::of`].
    #[cfg(feature = "std")]
    pub fn of_with(config: &FirmwareConfig, isa: Isa) -> Result<Self> {
        for (asked_for, is_there, what) in [
            (config.detector.enabled, config.has_detector(), "detector"),
            (config.detector.guard, config.has_guard(), "guard"),
        ] {
            ensure!(
                asked_for != Some(true) || is_there,
                "the {what} is on, but it watches the actor only and the geometric pilot flies: leave it out, or fly \
                 the actor"
            );
        }
        let (frozen, ablate) = (config.frozen_pilot()?, config.pilot.ablate);
        // The built-in detector is the built-in actor's.
        let is_imported = matches!(frozen, Some(FrozenPilot::Imported(_)));
        ensure!(
            !is_imported || !config.has_detector() || config.detector.file.is_some(),
            "an imported policy is to fly, and the detector that comes with this program judges the built-in actor: \
             give the policy's own (--detector-file FILE, made by `vigil detector collect` and `train` with --actor), \
             or add --detector off, and --guard on to have the recovery pilot warn and take over before a collision"
        );
        ensure!(
            ablate == Ablation::Nothing || matches!(frozen, Some(FrozenPilot::Actor(_))),
            "--ablate takes something from an actor, and another pilot is to fly"
        );
        let Some(frozen) = frozen else {
            let pilot = GeometricPilot::new(config.stack().pilot);
            return Ok(Self::unmonitored(FlightPilot::Geometric(pilot)));
        };
        let monitor = match config.frozen_detector()? {
            None => None,
            Some(detector) => {
                let monitor = Monitor::new(isa, frozen.head(Purpose::Multipliers)?, &frozen.sha256(), &detector);
                let mut monitor = monitor.map_err(|source| match &config.detector.file {
                    Some(path) => anyhow!("detector {}: {source}", path.display()),
                    None => anyhow!("detector built into this program: {source}"),
                })?;
                monitor.set_threshold(config.detector.threshold.unwrap_or(detector.threshold));
                Some(Box::new(monitor))
            }
        };
        let mut pilots = Self::learned(isa, &frozen, config.pilot.apf, monitor, config.is_monitored())?;
        if ablate != Ablation::Nothing
            && let FlightPilot::Learned(pilot) = pilots.pilot
        {
            pilots.pilot = FlightPilot::Learned(pilot.without(ablate));
        }
        Ok(pilots)
    }
}

#[cfg(feature = "std")]
impl FirmwareConfig {
    /// The actor or imported policy that is to fly; `None` when another pilot is.
    ///
    /// # Errors
    /// [`FileError`]: what is truncated, altered or of another architecture, by name.
    pub fn frozen_pilot(&self) -> Result<Option<FrozenPilot>, FileError> {
        match (self.pilot.kind, &self.pilot.actor_file) {
            (PilotKind::Geometric, _) => Ok(None),
            (PilotKind::Actor, file) => FrozenPilot::load_or_built_in(file.as_deref()).map(Some),
        }
    }

    /// The same if it is an actor of ours.
    ///
    /// # Errors
    /// As [`Self::frozen_pilot`].
    pub fn frozen_actor(&self) -> Result<Option<FrozenActor>, FileError> {
        Ok(self.frozen_pilot()?.and_then(|pilot| match pilot {
            FrozenPilot::Actor(actor) => Some(actor),
            FrozenPilot::Imported(_) => None,
        }))
    }

    /// What to tell where the pilot was trained to be faster than it may be.
    pub fn slowed(&self, pilot: &FrozenPilot) -> Option<String> {
        let (FrozenPilot::Actor(actor), limit_m_s) = (pilot, self.limits.speed_m_s) else {
            return None;
        };
        (actor.cruise_m_s > limit_m_s).then(|| {
            format!(
                "it was trained for {} m/s and flies {limit_m_s} at the most (--speed-limit)",
                actor.cruise_m_s
            )
        })
    }

    /// The detector that is to watch it; `None` when it is off, or no actor flies.
    ///
    /// # Errors
    /// [`FileError`]: a detector that is truncated, altered or of another architecture, by name.
    pub fn frozen_detector(&self) -> Result<Option<FrozenDetector>, FileError> {
        match (self.has_detector(), &self.detector.file) {
            (false, _) => Ok(None),
            (true, Some(path)) => Ok(Some(FrozenDetector::load(path)?)),
            (true, None) => Ok(Some(FrozenDetector::built_in()?)),
        }
    }
}
