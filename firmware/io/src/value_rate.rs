//! How often a link gets the guidance computer's values: each named value, and what the pilot sees. Four times a second
//! they are too many for a radio.

use vigil_mavlink::common::{MavMessage, NAMED_VALUE_FLOAT_DATA, OBSTACLE_DISTANCE_DATA};
use vigil_mavlink::framing::Packet;
use vigil_mavlink::mavlink::MessageData;
use vigil_types::{Nanos, STEP_NS};

/// Names distinguished; more than there are. What finds no room is sent each time.
const MAX_NAMES: usize = 32;
/// State, reasons and verdict: sent at once when they change.
const SENT_ON_CHANGE: [&[u8]; 3] = [b"gd_state", b"gd_reason", b"dt_state"];
/// But no more often than this: reasons may come and go with each step. The guidance computer repeats all values after
/// that time, so that the last change is never lost.
const CHANGE_NS: Nanos = 250_000_000;

#[derive(Debug, Clone, Copy)]
struct Sent {
    name: [u8; 10],
    value: u32,
    at_ns: Nanos,
}

/// What a link was sent, and when.
#[derive(Debug)]
pub(crate) struct ValueRate {
    /// `None`: everything passes. The longest time there is: changes only.
    interval_ns: Option<Nanos>,
    sent: heapless::Vec<Sent, MAX_NAMES>,
    /// What the pilot sees always passes: an autopilot that uses it forgets it after half a second.
    pub spares_obstacles: bool,
}

impl ValueRate {
    /// At most `per_s` of each value in a second; `None` for all of them.
    pub fn new(per_s: Option<f32>) -> Self {
        let interval_ns = |per_s: f32| match per_s > 0.0 {
            true => (1e9 / f64::from(per_s)) as Nanos,
            false => Nanos::MAX,
        };
        Self {
            interval_ns: per_s.map(interval_ns),
            sent: heapless::Vec::new(),
            spares_obstacles: false,
        }
    }

    /// Whether a packet is sent now. Packets that hold no value always are.
    pub fn passes(&mut self, now_ns: Nanos, packet: &Packet<'_>) -> bool {
        let (Some(interval_ns), Some((name, value))) = (self.interval_ns, value_of(packet)) else {
            return true;
        };
        if self.spares_obstacles && packet.message_id() == OBSTACLE_DISTANCE_DATA::ID {
            return true;
        }
        let new = Sent {
            name,
            value,
            at_ns: now_ns,
        };
        let Some(sent) = self.sent.iter_mut().find(|sent| sent.name == name) else {
            let _ = self.sent.push(new);
            return true;
        };
        // The step nearest to the time.
        let has_waited = |ns: Nanos| now_ns.saturating_sub(sent.at_ns).saturating_add(STEP_NS / 2) >= ns;
        let is_news =
            sent.value != value && SENT_ON_CHANGE.iter().any(|n| name.starts_with(n)) && has_waited(CHANGE_NS);
        let passes = is_news || has_waited(interval_ns);
        if passes {
            *sent = new;
        }
        passes
    }

    /// The packet was not sent after all: the next of its name is.
    pub fn forget(&mut self, packet: &Packet<'_>) {
        let of_packet = value_of(packet).map(|(name, _)| name);
        self.sent.retain(|other| Some(other.name) != of_packet);
    }
}

/// A value's name and bits. What the pilot sees is one value, of no name.
fn value_of(packet: &Packet<'_>) -> Option<([u8; 10], u32)> {
    match packet.message_id() {
        OBSTACLE_DISTANCE_DATA::ID => Some(([0; 10], 0)),
        NAMED_VALUE_FLOAT_DATA::ID => match packet.message() {
            Ok(MavMessage::NAMED_VALUE_FLOAT(m)) => Some((*m.name, m.value.to_bits())),
            _ => None,
        },
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_mavlink::common::HEARTBEAT_DATA;
    use vigil_mavlink::framing::{FramingCounters, encode, packets};
    use vigil_mavlink::message;

    fn passes(rate: &mut ValueRate, step: u64, message: &MavMessage) -> bool {
        let (packet, mut counters) = (encode((1, 191), 0, message), FramingCounters::default());
        rate.passes(step * STEP_NS, &packets(&packet, &mut counters).next().unwrap())
    }

    fn named(name: &str, value: f32) -> MavMessage {
        message!(NAMED_VALUE_FLOAT, name = name.into(), value)
    }

    #[test]
    fn each_value_comes_at_the_links_rate_and_other_messages_always() {
        let mut rate = ValueRate::new(Some(1.0));
        let obstacles = MavMessage::OBSTACLE_DISTANCE(OBSTACLE_DISTANCE_DATA::DEFAULT);
        let (mut goal, mut step_us, mut seen, mut others) = (0, 0, 0, 0);
        // Sent every fifth step, for 10 s.
        for step in (0..200).step_by(5) {
            goal += u32::from(passes(&mut rate, step, &named("goal_m", step as f32)));
            step_us += u32::from(passes(&mut rate, step, &named("step_us", step as f32)));
            seen += u32::from(passes(&mut rate, step, &obstacles));
            others += u32::from(passes(&mut rate, step, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT)));
        }
        assert_eq!((goal, step_us, seen, others), (10, 10, 10, 40));
        rate.spares_obstacles = true;
        assert!((200..220).all(|step| passes(&mut rate, step, &obstacles)));
        assert!(!passes(&mut rate, 190, &named("goal_m", 1.0)));
        let mut all = ValueRate::new(None);
        assert!((0..200).all(|step| passes(&mut all, step, &named("goal_m", 1.0))));
    }

    #[test]
    fn a_change_of_state_is_reported_at_once_and_one_that_flutters_four_times_a_second() {
        for per_s in [1.0, 0.0] {
            let mut rate = ValueRate::new(Some(per_s));
            assert!(passes(&mut rate, 0, &named("gd_state", 0.0)));
            assert!(!passes(&mut rate, 6, &named("gd_state", 0.0)));
            assert!(passes(&mut rate, 7, &named("gd_state", 1.0)));
            let fluttering = (8..108).filter(|step| passes(&mut rate, *step, &named("gd_state", (step % 2) as f32)));
            assert!((15..=20).contains(&fluttering.count()));
            assert!(
                passes(&mut rate, 115, &named("gd_state", 7.0)),
                "the last change is sent"
            );
        }
        let mut rate = ValueRate::new(Some(0.0));
        assert!(passes(&mut rate, 0, &named("goal_m", 1.0)));
        // One that found no room on the line comes again.
        let (packet, mut counters) = (encode((1, 191), 0, &named("goal_m", 1.0)), FramingCounters::default());
        rate.forget(&packets(&packet, &mut counters).next().unwrap());
        assert!(passes(&mut rate, 0, &named("goal_m", 1.0)));
        assert!((1..1000).all(|step| !passes(&mut rate, step, &named("goal_m", step as f32))));
    }
}
