//! One flight of the whole stack in lockstep, attacked or not: what every campaign repeats.

use crate::watch::WatchRecord;
use anyhow::Result;
use std::convert::Infallible;
use vigil_firmware::{FirmwareConfig, LockstepFirmware};
use vigil_sim::lockstep::{FirmwarePort, FlightRecord, fly_lockstep_through};
use vigil_sim::{Attack, AttackRecord, SimConfig, Simulator};
use vigil_types::{Datagrams, DepthFrame, Nanos};

/// What a flight came to.
pub struct Flown {
    /// How it ended.
    pub record: FlightRecord,
    /// What the attack did, if there was one.
    pub attack: Option<AttackRecord>,
    /// What the detector did, if there was one.
    pub watch: Option<WatchRecord>,
}

/// Flies a course to its end.
///
/// # Errors
/// A configuration that must not fly, an actor that is refused, an attack out of range.
pub fn fly(config: &SimConfig, firmware: &FirmwareConfig, attack: Option<&Attack>) -> Result<Flown> {
    let mut simulator = Simulator::new(config, 0)?;
    let mut firmware = SameProcess {
        firmware: LockstepFirmware::new(firmware)?,
        watch: WatchRecord::default(),
    };
    let mut adversary = attack
        .map(|attack| attack.interceptor(config.seed, config.course.goal_ned_m()))
        .transpose()?;
    let mut done = attack.map(|_| AttackRecord::default());
    // Only a frame of another size is refused, and the simulator makes none.
    let mut between = |step: u64, frame: &mut DepthFrame| {
        if let (Some(adversary), Some(done)) = (&mut adversary, &mut done)
            && let Ok(passed) = adversary.pass(step, frame)
        {
            done.observe(step, &passed);
        }
    };
    let time_limit_s = f64::from(config.course.time_limit_s);
    let Ok(record) = fly_lockstep_through(&mut simulator, &mut between, &mut firmware, time_limit_s, 0.0);
    Ok(Flown {
        record,
        attack: done,
        watch: firmware.watch.was_watched().then_some(firmware.watch),
    })
}

struct SameProcess {
    firmware: LockstepFirmware,
    watch: WatchRecord,
}

impl FirmwarePort for SameProcess {
    type Error = Infallible;

    fn step(
        &mut self,
        step: u64,
        now_ns: Nanos,
        frame: &DepthFrame,
        received: &Datagrams,
        sent: &mut Datagrams,
    ) -> Result<(), Infallible> {
        let report = self.firmware.step(now_ns, Some(frame), received, sent);
        self.watch.observe(step, report);
        Ok(())
    }
}
