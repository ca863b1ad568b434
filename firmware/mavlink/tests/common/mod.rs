//! Scripted vehicles and a loop around companion and guidance.
#![allow(dead_code)] // each test program uses a part of it

pub mod peer;

use peer::Peer;
use vigil_guidance::{EngagePolicy, FrameStatus, Guidance, GuidanceConfig, GuidanceInput, GuidanceOutput};
use vigil_mavlink::common::{MavAutopilot, MavCmd, MavFrame, MavType};
use vigil_mavlink::framing::{Command, CommandForm, FramingCounters, encode, packets};
use vigil_mavlink::{Companion, CompanionConfig, Flavour, MavHeader, MavMessage, Sender, message};
use vigil_types::{
    Action, Datagrams, GuidanceState, Nanos, OperatorRequest, Reasons, RequestOutcome, STEP_NS, StepReport, StepTiming,
    VehicleRequest, VelocitySetpoint,
};

/// A ground station, as most are numbered.
pub const GROUND_STATION: (u8, u8) = (255, 190);
pub const VEHICLE: (u8, u8) = (1, 1);
/// The guidance computer.
pub const ME: (u8, u8) = (1, 191);

pub fn bytes_of(from: (u8, u8), message: &MavMessage) -> Vec<u8> {
    encode(from, 0, message)
}

/// A command to the guidance computer, known or not.
pub fn raw_command(number: u16, params: [f32; 7], form: CommandForm) -> Vec<u8> {
    let mut command = Command::to_autopilot(1, number, params, 0);
    (command.target_component, command.form) = (191, form);
    let mut out = Datagrams::default();
    Sender::new(GROUND_STATION.0, GROUND_STATION.1).command(&mut out, 0, &command);
    out.last().expect("fits").to_vec()
}

/// All messages of all datagrams with their senders, parsed by the crate.
pub fn messages(sent: &Datagrams) -> Vec<(MavHeader, MavMessage)> {
    let mut counters = FramingCounters::default();
    let found = sent
        .iter()
        .flat_map(|(_, datagram)| {
            packets(datagram, &mut counters)
                .map(|p| (p.header(), p.message().expect("what the companion sends can be parsed")))
                .collect::<Vec<_>>()
        })
        .collect();
    let refused = FramingCounters { packets: 0, ..counters };
    assert_eq!(
        refused,
        FramingCounters::default(),
        "what the companion sends is well formed"
    );
    found
}

/// The messages of one kind among those of [`messages`].
#[macro_export]
macro_rules! only {
    ($messages:expr, $kind:ident) => {
        $messages.into_iter().filter_map(|(_, message)| match message {
            vigil_mavlink::MavMessage::$kind(found) => Some(found),
            _ => None,
        })
    };
}

/// An autopilot's heartbeat, or that of something that is none.
pub fn heartbeat(autopilot: MavAutopilot) -> MavMessage {
    message!(HEARTBEAT, autopilot, mavtype = MavType::MAV_TYPE_QUADROTOR)
}

/// The texts of a step, chunks put together as the protocol says.
pub fn texts(sent: &Datagrams) -> Vec<String> {
    let mut texts: Vec<(u16, String)> = Vec::new();
    for t in only!(messages(sent), STATUSTEXT) {
        let chunk = t.text.to_str().expect("text is UTF-8");
        match texts.last_mut() {
            Some((id, text)) if t.id != 0 && *id == t.id => {
                assert_eq!(text.len(), 50 * usize::from(t.chunk_seq));
                text.push_str(chunk);
            }
            _ => {
                assert_eq!(t.chunk_seq, 0);
                texts.push((t.id, chunk.to_owned()));
            }
        }
    }
    texts.into_iter().map(|(_, text)| text).collect()
}

pub fn named_values(sent: &Datagrams) -> Vec<(String, f32)> {
    only!(messages(sent), NAMED_VALUE_FLOAT)
        .map(|m| (m.name.to_str().expect("a name is UTF-8").to_owned(), m.value))
        .collect()
}

pub fn command_long(command: MavCmd, (target_system, target_component): (u8, u8), param1: f32) -> MavMessage {
    message!(COMMAND_LONG, param1, command, target_system, target_component)
}

pub fn reposition(frame: MavFrame, x: i32, y: i32, z: f32) -> MavMessage {
    message!(
        COMMAND_INT,
        param1 = -1.0,
        param2 = 1.0,
        param4 = f32::NAN,
        x,
        y,
        z,
        command = MavCmd::MAV_CMD_DO_REPOSITION,
        target_system = 1,
        target_component = 191,
        frame
    )
}

/// A report of a step in which nothing happens.
pub fn report(now_ns: Nanos, state: GuidanceState) -> StepReport {
    StepReport {
        now_ns,
        state,
        ..Default::default()
    }
}

/// Companion, guidance and a scripted vehicle, 20 steps a second. The pilot flies straight ahead.
pub struct Flight {
    pub now_ns: Nanos,
    pub companion: Companion,
    pub guidance: Guidance,
    pub peer: Peer,
    pub sent: Datagrams,
    pub last: Option<GuidanceOutput>,
    /// Everything said by STATUSTEXT.
    pub texts: Vec<String>,
    /// Frames are delivered.
    pub sees: bool,
    /// Packets from the vehicle arrive.
    pub hears: bool,
}

impl Flight {
    pub fn new(flavour: Flavour, peer: Peer) -> Self {
        let config = GuidanceConfig {
            engage: EngagePolicy::Auto,
            ..Default::default()
        };
        Self::of(Some(flavour), peer, config)
    }

    /// An operator engages it.
    pub fn on_command(flavour: Flavour, peer: Peer) -> Self {
        Self::of(Some(flavour), peer, GuidanceConfig::default())
    }

    /// `flavour`: the configured one, `None` to recognise it.
    pub fn of(flavour: Option<Flavour>, peer: Peer, config: GuidanceConfig) -> Self {
        let mut guidance = Guidance::new(config).expect("valid");
        guidance.request(OperatorRequest::Goal {
            north_m: 12.0,
            east_m: 0.0,
            height_m: Some(3.0),
        });
        Self {
            now_ns: 50_000_000_000,
            companion: Companion::new(CompanionConfig {
                flavour,
                ..Default::default()
            }),
            guidance,
            peer,
            sent: Datagrams::default(),
            last: None,
            texts: Vec::new(),
            sees: true,
            hears: true,
        }
    }

    pub fn hear(&mut self, from: (u8, u8), message: &MavMessage) {
        self.companion.receive(self.now_ns, 0, &bytes_of(from, message));
    }

    pub fn step(&mut self) -> GuidanceOutput {
        self.now_ns += STEP_NS;
        for datagram in self.peer.step(self.now_ns) {
            if self.hears {
                self.companion.receive(self.now_ns, 0, &datagram);
            }
        }
        while let Some(pending) = self.companion.take_request() {
            let outcome = self.guidance.request(pending.request());
            self.companion.answer(&pending, outcome);
        }
        let telemetry = *self.companion.telemetry();
        let limit_ns = self.guidance.config().telemetry_age_limit_ns;
        let fresh = telemetry
            .flight_data_age_ns(self.now_ns)
            .is_some_and(|age| age <= limit_ns);
        let action = (self.sees && fresh && telemetry.is_finite()).then_some(Action::new(1.0, 0.0));
        let output = self.guidance.step(&GuidanceInput {
            now_ns: self.now_ns,
            telemetry: &telemetry,
            frame: FrameStatus {
                age_ns: self.sees.then_some(STEP_NS),
                ..FrameStatus::default()
            },
            action,
            recovery: None,
            verdict: None,
            risk: None,
            smooth_share: None,
            timing: StepTiming::default(),
            vehicle: self.companion.vehicle_status(),
        });
        let report = StepReport {
            now_ns: self.now_ns,
            state: output.state,
            reasons: output.reasons,
            setpoint: output.setpoint,
            telemetry,
            ..Default::default()
        };
        self.sent.clear();
        self.companion.emit(&report, output.request, &mut self.sent);
        assert_eq!(self.sent.dropped(), 0);
        self.texts.extend(texts(&self.sent));
        for (_, datagram) in self.sent.iter() {
            self.peer.receive(self.now_ns, datagram);
        }
        self.last = Some(output);
        output
    }

    /// A text with these words came.
    #[track_caller]
    pub fn assert_said(&self, words: &str) {
        let texts = &self.texts;
        assert!(
            texts.iter().any(|text| text.contains(words)),
            "not `{words}`: {texts:?}"
        );
    }

    /// Steps until the state is reached, at most 60 s.
    pub fn until(&mut self, state: GuidanceState) {
        for _ in 0..1200 {
            if self.step().state == state {
                return;
            }
        }
        panic!(
            "{} was not reached: {:?} {:?} {:?}",
            state.name(),
            self.last,
            self.texts,
            self.peer
        );
    }

    pub fn run(&mut self, steps: usize) -> GuidanceOutput {
        (0..steps).map(|_| self.step()).last().expect("at least one step")
    }

    /// State and reasons after so many steps.
    pub fn ends(&mut self, steps: usize) -> (GuidanceState, Reasons) {
        let output = self.run(steps);
        (output.state, output.reasons)
    }

    /// An operator engages as soon as guidance is ready.
    pub fn engage(&mut self) {
        self.until(GuidanceState::Ready);
        let outcome = self.guidance.request(OperatorRequest::Engage);
        assert_eq!(outcome, RequestOutcome::Accepted);
    }

    /// The same, until the vehicle is flown.
    pub fn engage_and_fly(&mut self) {
        self.engage();
        self.until(GuidanceState::Guided);
    }
}

/// Emits steps of a companion without guidance.
pub struct Bench {
    pub now_ns: Nanos,
    pub companion: Companion,
    pub sent: Datagrams,
}

impl Bench {
    pub fn new(flavour: Flavour) -> Self {
        Self {
            now_ns: 7_000_000_000,
            companion: Companion::new(CompanionConfig {
                flavour: Some(flavour),
                ..Default::default()
            }),
            sent: Datagrams::default(),
        }
    }

    pub fn hear(&mut self, from: (u8, u8), message: &MavMessage) {
        self.companion.receive(self.now_ns, 0, &bytes_of(from, message));
    }

    pub fn step(
        &mut self,
        state: GuidanceState,
        reasons: Reasons,
        request: VehicleRequest,
    ) -> Vec<(MavHeader, MavMessage)> {
        self.now_ns += STEP_NS;
        let setpoint = (state == GuidanceState::Hold).then_some(VelocitySetpoint::HOLD);
        let report = StepReport {
            reasons,
            setpoint,
            ..report(self.now_ns, state)
        };
        self.emit(&report, request);
        messages(&self.sent)
    }

    pub fn emit(&mut self, report: &StepReport, request: VehicleRequest) {
        self.sent.clear();
        self.companion.emit(report, request, &mut self.sent);
    }
}
