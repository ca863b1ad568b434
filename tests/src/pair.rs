//! Simulator and firmware in lockstep in one process, for tests that look into both.

use vigil_firmware::{FirmwareConfig, LockstepFirmware};
use vigil_mavlink::MavMessage;
use vigil_mavlink::framing::{FramingCounters, packets};
use vigil_sim::world::{Course, Family, Outcome, generate};
use vigil_sim::{SimConfig, Simulator, Start};
use vigil_types::{Datagrams, DepthFrame, GuidanceState, Reasons, STEP_S, StepReport};

/// A vehicle that hovers at the start of a course.
pub fn airborne(course: Course, seed: u64) -> SimConfig {
    let mut config = SimConfig::new(course, seed);
    config.start = Start::Airborne;
    config
}

/// A simulated vehicle, and the firmware that flies it.
pub struct Pair {
    /// The simulator.
    pub simulator: Simulator,
    /// The firmware.
    pub firmware: LockstepFirmware,
    /// The newest frame.
    pub frame: Box<DepthFrame>,
    /// What the vehicle has sent in this step.
    pub to_firmware: Box<Datagrams>,
    from_firmware: Box<Datagrams>,
}

impl Pair {
    /// Both on the course of a seed, the vehicle hovering at its start.
    pub fn new(family: Family, seed: u64) -> Self {
        Self::with(family, seed, |_, _| {})
    }

    /// The same, but for `change`.
    pub fn with(family: Family, seed: u64, change: impl FnOnce(&mut SimConfig, &mut FirmwareConfig)) -> Self {
        let mut simulation = airborne(generate(family, seed), seed);
        let mut firmware = FirmwareConfig::to_goal(simulation.course.goal_ned_m());
        change(&mut simulation, &mut firmware);
        Self::of(&simulation, &firmware)
    }

    /// Both as they are configured.
    pub fn of(simulation: &SimConfig, firmware: &FirmwareConfig) -> Self {
        Self {
            simulator: Simulator::new(simulation, 0).expect("a simulator"),
            firmware: LockstepFirmware::new(firmware).expect("a firmware"),
            frame: Box::new(DepthFrame::EMPTY),
            to_firmware: Box::default(),
            from_firmware: Box::default(),
        }
    }

    /// The simulator's half of a step.
    pub fn simulate(&mut self) {
        self.simulator
            .lockstep(&self.from_firmware, &mut self.frame, &mut self.to_firmware);
    }

    /// The firmware's half of a step, with the frame or blind.
    pub fn decide(&mut self, sees: bool) -> StepReport {
        let frame = sees.then_some(&*self.frame);
        *self.firmware.step(
            self.simulator.now_ns(),
            frame,
            &self.to_firmware,
            &mut self.from_firmware,
        )
    }

    /// A packet of somebody else's that reaches the vehicle with what the firmware said in this step.
    pub fn to_vehicle(&mut self, packet: &[u8]) {
        assert!(self.from_firmware.push(0, packet), "no room");
    }

    /// What the firmware said to people in this step.
    pub fn texts(&self) -> Vec<String> {
        texts(&self.from_firmware)
    }

    /// The firmware says nothing in this step.
    pub fn silence(&mut self) {
        self.from_firmware.clear();
    }

    /// Flies to the flight's end, but for no more than so many steps; what each came to. `spoil` has its hand between vehicle, sensor
    /// and firmware in each step, and says whether the frame arrives.
    pub fn fly(&mut self, steps: usize, mut spoil: impl FnMut(&mut Self, usize) -> bool) -> Vec<StepReport> {
        let mut reports = Vec::new();
        while reports.len() < steps && self.simulator.ending().is_none() {
            self.simulate();
            let arrives = spoil(self, reports.len());
            reports.push(self.decide(arrives));
        }
        reports
    }

    /// How the flight ended, if it has.
    pub fn outcome(&self) -> Option<Outcome> {
        self.simulator.ending().map(|ending| ending.outcome)
    }

    /// The vehicle's true speed.
    pub fn speed_m_s(&self) -> f32 {
        self.simulator.truth().velocity_ned_m_s.norm()
    }

    /// Flies until guidance has flown for `steps`, but for no more than so many in all; how many it took.
    pub fn fly_guided(&mut self, steps: usize, most_steps: usize) -> usize {
        let (mut guided, mut flown) = (0, 0);
        while guided < steps && flown < most_steps && self.simulator.ending().is_none() {
            self.simulate();
            guided += usize::from(self.decide(true).state == GuidanceState::Guided);
            flown += 1;
        }
        flown
    }
}

/// Flies a course to its end, with the default firmware but for `change`; how it ended, and every step's report.
pub fn fly_monitored(
    simulation: &SimConfig,
    change: impl FnOnce(&mut FirmwareConfig),
) -> (Option<Outcome>, Vec<StepReport>) {
    let mut config = FirmwareConfig::to_goal(simulation.course.goal_ned_m());
    change(&mut config);
    let mut pair = Pair::of(simulation, &config);
    // The referee does not see a vehicle that never lifts off: a minute is ample for arming and take-off.
    let most_steps = ((simulation.course.time_limit_s + 60.0) / STEP_S) as usize;
    let reports = pair.fly(most_steps, |_, _| true);
    (pair.outcome(), reports)
}

/// Everything that was wrong in some steps.
pub fn reasons(reports: &[StepReport]) -> Reasons {
    reports
        .iter()
        .fold(Reasons::NONE, |all, report| all.union(report.reasons))
}

/// The datagrams that hold no message of these numbers.
pub fn without(said: &Datagrams, ids: &[u32]) -> Box<Datagrams> {
    let mut kept = Box::<Datagrams>::default();
    for (link, datagram) in said.iter() {
        let mut counters = FramingCounters::default();
        if packets(datagram, &mut counters).all(|packet| !ids.contains(&packet.message_id())) {
            kept.push(link, datagram);
        }
    }
    kept
}

/// The beginnings (50 bytes) of the STATUSTEXTs in some datagrams.
pub fn texts(said: &Datagrams) -> Vec<String> {
    let mut counters = FramingCounters::default();
    let mut texts = Vec::new();
    for (_, datagram) in said.iter() {
        for packet in packets(datagram, &mut counters) {
            if let Ok(MavMessage::STATUSTEXT(text)) = packet.message()
                && text.chunk_seq == 0
            {
                texts.extend(text.text.to_str().map(str::to_owned));
            }
        }
    }
    texts
}
