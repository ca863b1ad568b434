//! Which components were seen on which link, and where a packet goes on to.
//!
//! The rules are those of <https://mavlink.io/en/guide/routing.html>: a broadcast goes to every other link; a message for
//! a system or component goes to the links where it was seen, never back to where it came from.

use crate::core::ComponentId;
use vigil_types::Nanos;

/// Components remembered. More than a vehicle ever meets; the bound keeps a flood of made-up senders from growing it.
const CAPACITY: usize = 64;

#[derive(Debug, Clone, Copy)]
struct Seen {
    component: ComponentId,
    /// One bit per link.
    links: u8,
    last_ns: Nanos,
}

/// The table of who was seen where.
#[derive(Debug, Default)]
pub(crate) struct Routing {
    seen: Vec<Seen>,
}

impl Routing {
    /// Notes a sender.
    pub fn note(&mut self, now_ns: Nanos, component: ComponentId, link: u8) {
        let bit = 1 << link;
        if let Some(entry) = self.seen.iter_mut().find(|s| s.component == component) {
            entry.links |= bit;
            entry.last_ns = now_ns;
            return;
        }
        let entry = Seen {
            component,
            links: bit,
            last_ns: now_ns,
        };
        if self.seen.len() < CAPACITY {
            self.seen.push(entry);
        } else if let Some(oldest) = self.seen.iter_mut().min_by_key(|s| s.last_ns) {
            *oldest = entry;
        }
    }

    /// The links (one bit each) that a packet from `from_link` goes on to. `own` is this vehicle's autopilot.
    pub fn onward(&self, own: ComponentId, target: Option<(u8, u8)>, from_link: u8, links: usize) -> u8 {
        let all = u8::MAX >> (8 - links.clamp(1, 8));
        let wanted = match target {
            None | Some((0, _)) => all,
            Some((system, component)) if (ComponentId { system, component }) == own => 0,
            Some((system, component)) => self
                .seen
                .iter()
                .filter(|s| s.component.system == system && (component == 0 || s.component.component == component))
                .fold(0, |links, s| links | s.links),
        };
        wanted & all & !(1 << from_link)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWN: ComponentId = ComponentId {
        system: 1,
        component: 1,
    };

    fn id(system: u8, component: u8) -> ComponentId {
        ComponentId { system, component }
    }

    #[test]
    fn a_targeted_packet_goes_where_its_target_was_seen_and_never_back() {
        let mut routing = Routing::default();
        routing.note(1, id(1, 191), 0);
        routing.note(2, id(245, 190), 1);
        assert_eq!(routing.onward(OWN, Some((1, 191)), 1, 3), 0b001);
        assert_eq!(routing.onward(OWN, Some((245, 190)), 0, 3), 0b010);
        assert_eq!(routing.onward(OWN, Some((1, 191)), 0, 3), 0);
        assert_eq!(routing.onward(OWN, Some((9, 9)), 0, 3), 0);
    }

    #[test]
    fn broadcasts_go_everywhere_else_and_what_is_for_the_vehicle_stays() {
        let mut routing = Routing::default();
        routing.note(1, id(1, 191), 0);
        assert_eq!(routing.onward(OWN, None, 0, 3), 0b110);
        assert_eq!(routing.onward(OWN, Some((0, 0)), 2, 3), 0b011);
        assert_eq!(routing.onward(OWN, Some((1, 1)), 2, 3), 0);
        // All components of the vehicle's system: the companion is one of them.
        assert_eq!(routing.onward(OWN, Some((1, 0)), 2, 3), 0b001);
    }

    #[test]
    fn made_up_senders_cannot_grow_the_table() {
        let mut routing = Routing::default();
        for i in 0..10_000_u32 {
            let [a, b, ..] = i.to_le_bytes();
            routing.note(u64::from(i), id(a, b), 1);
        }
        assert_eq!(routing.seen.len(), CAPACITY);
        assert_eq!(
            routing.onward(OWN, Some((9999_u32.to_le_bytes()[0], 9999_u32.to_le_bytes()[1])), 0, 3),
            0b010
        );
    }
}
