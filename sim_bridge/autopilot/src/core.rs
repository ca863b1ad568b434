//! What all services share: time, the vehicle's view, flight state, parameters, and what waits to be sent. It knows none of
//! them.

use crate::files::FileSystem;
use crate::flight::mode::FlightMode;
use crate::flight::setpoint_owner::Setpoints;
use crate::flight::state::{Commander, Failsafe, LandedState, LostSensors, Sticks};
use crate::outbox::{Outbox, Traffic};
use crate::plan::Plans;
use crate::vehicle::{HoldLaw, Truth, VehicleView};
use crate::vehicle_parameters::{ParamId, ParameterValue, Parameters};
use crate::{ConfigError, EndpointConfig, LinkId, LinkRole};
use vigil_mavlink::common::{FENCE_STATUS_DATA, MavSeverity};
use vigil_mavlink::framing::{FramingCounters, Packet};
use vigil_mavlink::mavlink::MessageData;
pub use vigil_mavlink::routing::ComponentId;
use vigil_mavlink::{Allowance, MavMessage, StatusText};
use vigil_types::{Nanos, RANGE_SECTORS};

macro_rules! refusals {
    ($($(#[$what:meta])* $field:ident = $name:literal,)*) => {
        /// What was refused since start, besides what the framing refused.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
        pub struct Refusals { $($(#[$what])* pub $field: u64,)* }

        impl Refusals {
            /// What was refused, with its name.
            pub fn named(&self) -> [(&'static str, u64); 11] {
                [$(($name, self.$field)),*]
            }
        }
    };
}

refusals! {
    /// Packets that claim to come from this vehicle's autopilot.
    own_identity = "packets in the vehicle's name",
    /// Messages addressed to the vehicle that hold a value which the protocol does not have.
    not_parsed = "not understood",
    /// Setpoints with a frame or type mask that the vehicle does not fly.
    setpoint_form = "setpoints of a kind that is not flown",
    /// Setpoints with a value that is not finite or absurd.
    setpoint_value = "setpoints with absurd values",
    /// Setpoints of others while the owner holds OFFBOARD, those included that claim its identity elsewhere.
    setpoint_foreign = "setpoints of others than their owner",
    /// Commands answered UNSUPPORTED.
    command_unsupported = "unknown commands",
    /// Commands answered DENIED or TEMPORARILY_REJECTED.
    command_denied = "commands denied",
    /// Parameter sets and reads refused.
    parameter = "parameters",
    /// File transfer requests answered NAK, the end of a file or listing included.
    file = "file requests",
    /// Plans refused, and messages of the mission protocol that fit no transfer.
    plan = "plans",
    /// Packets for other links beyond what is passed on of one link.
    crowded_out = "packets beyond what is passed on",
}

/// What the simulator may show and a test may check.
#[derive(Debug, Clone, PartialEq)]
pub struct EndpointStatus {
    /// Flight mode.
    pub mode: FlightMode,
    /// Motors armed.
    pub armed: bool,
    /// On the ground or in the air.
    pub landed: LandedState,
    /// The failsafe in force.
    pub failsafe: Option<Failsafe>,
    /// Flight was terminated: motors off until a reboot.
    pub terminated: bool,
    /// Whose setpoints are flown.
    pub setpoint_owner: Option<ComponentId>,
    /// Packets found and refused by the framing.
    pub framing: FramingCounters,
    /// Everything else refused.
    pub refusals: Refusals,
    /// Packets that were not sent because nobody took them.
    pub dropped: u64,
}

/// What SETUP_SIGNING asks for: for the owner of the links.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct SigningSetup {
    /// The key.
    pub key: [u8; 32],
    /// Timestamp to begin with, in units of 10 µs since 2015-01-01.
    pub initial_timestamp: u64,
}

/// Longest time that a number from outside may stand for, a century: its sum with any clock's reading fits [`Nanos`].
const LONGEST_S: f64 = 3.2e9;

/// A number of seconds that came from outside, as a time; `None` where it is none: NaN, negative, longer than a century.
pub(crate) fn nanos(seconds: f64) -> Option<Nanos> {
    (0.0..=LONGEST_S)
        .contains(&seconds)
        .then(|| libm::round(seconds * 1e9) as Nanos)
}

/// Bytes with zeros behind them: a payload whose zeros were cut off, or the last piece of a file.
pub(crate) fn padded<const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut padded = [0; N];
    let len = bytes.len().min(N);
    padded[..len].copy_from_slice(&bytes[..len]);
    padded
}

/// Texts that wait for the flight log, at most.
const MOST_UNLOGGED: usize = 64;
/// Refusals that are said in a second, at most.
const REFUSALS_SAID_PER_S: u32 = 4;

/// What a sensor of zones beside the depth camera measured: horizontal distances, left to right over its field of view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ZoneRanges {
    /// Metres; infinite where nothing is within reach. The first `columns` count.
    pub range_m: [f32; RANGE_SECTORS],
    /// How many there are.
    pub columns: usize,
    /// Its field of view, radians.
    pub fov_rad: f32,
    /// Its reach, metres.
    pub farthest_m: f32,
}

/// Shared state.
#[derive(Default)]
pub(crate) struct Core {
    pub now_ns: Nanos,
    /// Time of the first step, the origin of `time_boot_ms`.
    pub boot_ns: Option<Nanos>,
    pub view: VehicleView,
    /// What the vehicle's hold is.
    pub hold_law: HoldLaw,
    /// Where home is: metres north and east of the local origin, at its height.
    pub home_m: (f32, f32),
    pub unix_time_at_zero_us: u64,
    pub parameters: Parameters,
    pub commander: Commander,
    /// The autopilot was started anew, and whoever simulates the vehicle has not heard of it.
    pub rebooted: bool,
    pub setpoints: Setpoints,
    pub sticks: Sticks,
    pub lost_sensors: LostSensors,
    /// What the simulator said of the truth: for the one message that clients know as such.
    pub truth: Option<Truth>,
    /// What the second sensor measured last, if there is one.
    pub ranges: Option<ZoneRanges>,
    /// A new signing key that the links have not taken yet.
    pub signing_setup: Option<SigningSetup>,
    pub plans: Plans,
    /// Whether the vehicle is outside its geofence, and how often it has been.
    pub fence_status: FENCE_STATUS_DATA,
    pub outbox: Outbox,
    pub files: FileSystem,
    pub framing: FramingCounters,
    /// What came on each link.
    pub received: Vec<Traffic>,
    /// What each link is for.
    pub roles: Vec<LinkRole>,
    pub refusals: Refusals,
    pub texts: u64,
    pub refusals_said: Allowance,
    /// Texts since the last record of the flight log.
    pub unlogged: Vec<(MavSeverity, String)>,
    /// Messages to send at the end of this call, besides their streams: on one link or on all.
    pub wanted: Vec<(Option<LinkId>, u32)>,
}

impl Core {
    pub fn new(config: &EndpointConfig) -> Result<Self, ConfigError> {
        if config.system_id == 0 {
            return Err(ConfigError::SystemId);
        }
        if !(1..=EndpointConfig::MAX_LINKS).contains(&config.links.len()) {
            return Err(ConfigError::Links(config.links.len()));
        }
        let mut parameters = Parameters::new(&config.parameters)?;
        parameters.tell("MAV_SYS_ID", ParameterValue::Integer(config.system_id.into()));
        let mut view = VehicleView::default();
        (view.sensors.battery_remaining, view.on_ground) = (1.0, true);
        Ok(Self {
            view,
            unix_time_at_zero_us: config.unix_time_at_zero_us,
            now_ns: config.started_ns,
            parameters,
            outbox: Outbox::new(config.system_id, config.links.len()),
            received: vec![Traffic::default(); config.links.len()],
            roles: config.links.clone(),
            wanted: Vec::with_capacity(8),
            ..Self::default()
        })
    }

    /// Who the vehicle is.
    pub fn id(&self) -> ComponentId {
        ComponentId {
            system: self.outbox.system_id,
            component: 1,
        }
    }

    /// A parameter's value.
    #[inline]
    pub fn param(&self, id: ParamId) -> f32 {
        self.parameters.get(id)
    }

    /// A parameter of seconds as a time.
    pub fn param_ns(&self, id: ParamId) -> Nanos {
        (f64::from(self.param(id)) * 1e9) as Nanos
    }

    /// Milliseconds since the first step.
    pub fn time_boot_ms(&self) -> u32 {
        (self.since_boot_ns() / 1_000_000) as u32
    }

    /// Nanoseconds since the first step.
    pub fn since_boot_ns(&self) -> Nanos {
        self.now_ns.saturating_sub(self.boot_ns.unwrap_or(self.now_ns))
    }

    /// Microseconds since the first step.
    pub fn time_boot_us(&self) -> u64 {
        self.since_boot_ns() / 1000
    }

    /// Unix time in seconds, by the endpoint's own fixed calendar.
    pub fn unix_time_s(&self) -> u64 {
        (self.unix_time_at_zero_us + self.now_ns / 1000) / 1_000_000
    }

    /// Sends a text to people on all links; longer than 50 bytes in chunks of one id.
    /// <https://mavlink.io/en/messages/common.html#STATUSTEXT>
    pub fn text(&mut self, severity: MavSeverity, text: &str) {
        self.texts += 1;
        if self.unlogged.len() < MOST_UNLOGGED {
            self.unlogged.push((severity, text.to_owned()));
        }
        let id = (self.texts % u64::from(u16::MAX)) as u16 + 1;
        for message in StatusText::new(severity, format_args!("{text}")).messages(id) {
            self.outbox.send_all(&message);
        }
    }

    /// A text of something that is not as it should be.
    pub fn warn(&mut self, text: &str) {
        self.text(MavSeverity::MAV_SEVERITY_WARNING, text);
    }

    /// A text of a refusal, few a second: a flood on one link must not become one on all.
    pub fn warn_refused(&mut self, text: &str) {
        let said = &mut self.refusals_said;
        if said.takes(self.now_ns, 1_000_000_000, REFUSALS_SAID_PER_S) {
            self.warn(text);
        }
    }

    /// A text of something that is as it should be.
    pub fn inform(&mut self, text: &str) {
        self.text(MavSeverity::MAV_SEVERITY_INFO, text);
    }

    /// What a packet of this message holds; `None` where it is another message, or one that does not parse, which is counted.
    pub fn read<M: MessageData<Message = MavMessage>>(&mut self, packet: &Packet<'_>) -> Option<M> {
        if packet.message_id() != M::ID {
            return None;
        }
        let read = M::deser(packet.version(), packet.payload()).ok();
        self.refusals.not_parsed += u64::from(read.is_none());
        read
    }

    /// Asks for a message to be sent on all links at once, besides its stream: it changed.
    pub fn announce<M: MessageData>(&mut self) {
        if !self.wanted.contains(&(None, M::ID)) {
            self.wanted.push((None, M::ID));
        }
    }
}
