//! Which components were seen on which link, and where a packet goes on to.
//!
//! The rules are those of <https://mavlink.io/en/guide/routing.html>: a broadcast goes to every other link; a message for
//! a system or component goes to the links where it was seen, never back to where it came from.

use heapless::Vec;
use vigil_types::Nanos;

/// Links that can be distinguished.
pub const MAX_LINKS: usize = 8;
/// Components remembered of each link; more than a link ever has. Each link has room of its own, so that a flood of
/// made-up senders on one does not make those on another forgotten.
const SEEN_PER_LINK: usize = 32;

/// A MAVLink component: the sender or owner of something.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ComponentId {
    /// System id.
    pub system: u8,
    /// Component id.
    pub component: u8,
}

impl core::fmt::Display for ComponentId {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}/{}", self.system, self.component)
    }
}

/// Links, one bit each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkSet(u8);

impl LinkSet {
    /// No link.
    pub const NONE: Self = Self(0);

    /// The first `count` links, at most [`MAX_LINKS`].
    pub fn first(count: usize) -> Self {
        Self((0..count.min(MAX_LINKS)).fold(0, |bits, link| bits | 1 << link))
    }

    /// One link.
    pub fn only(link: u8) -> Self {
        Self(bit(link))
    }

    /// The same without a link.
    pub fn without(self, link: u8) -> Self {
        Self(self.0 & !bit(link))
    }

    /// Whether a link is in it.
    pub fn contains(self, link: u8) -> bool {
        self.0 & bit(link) != 0
    }

    /// Whether none is in it.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The links' numbers.
    pub fn iter(self) -> impl Iterator<Item = u8> {
        (0..MAX_LINKS as u8).filter(move |link| self.contains(*link))
    }
}

/// No bit for a number that no link has.
fn bit(link: u8) -> u8 {
    1_u8.checked_shl(link.into()).unwrap_or(0)
}

/// The table of who was seen where, and when last. Fixed memory.
#[derive(Debug, Clone, Default)]
pub struct Routing {
    seen: [Vec<(ComponentId, Nanos), SEEN_PER_LINK>; MAX_LINKS],
}

impl Routing {
    /// Notes a sender. When a link has more of them than are remembered, the one that was silent longest gives way.
    pub fn note(&mut self, now_ns: Nanos, component: ComponentId, link: u8) {
        let Some(seen) = self.seen.get_mut(usize::from(link)) else {
            return;
        };
        let new = (component, now_ns);
        if let Some(known) = seen.iter_mut().find(|(known, _)| *known == component) {
            *known = new;
        } else if seen.push(new).is_err()
            && let Some(oldest) = seen.iter_mut().min_by_key(|(_, last_ns)| *last_ns)
        {
            *oldest = new;
        }
    }

    /// Forgets a component on all links but one.
    pub fn keep_only_on(&mut self, link: u8, component: ComponentId) {
        for (_, seen) in (0..).zip(&mut self.seen).filter(|(number, _)| *number != link) {
            seen.retain(|(known, _)| *known != component);
        }
    }

    /// The links on which a packet's target may be: all of `links` for a broadcast, else those where it was seen.
    pub fn toward(&self, target: Option<(u8, u8)>, links: usize) -> LinkSet {
        let all = LinkSet::first(links);
        let (system, component) = match target {
            None | Some((0, _)) => return all,
            Some(target) => target,
        };
        let is_target = |(known, _): &(ComponentId, Nanos)| {
            known.system == system && (component == 0 || known.component == component)
        };
        let seen = self.seen.iter().zip(0..).filter(|(seen, _)| seen.iter().any(is_target));
        LinkSet(seen.fold(0, |bits, (_, link)| bits | bit(link)) & all.0)
    }

    /// The links that a packet from `from_link` goes on to. What is for `own` stays.
    pub fn onward(&self, own: ComponentId, target: Option<(u8, u8)>, from_link: u8, links: usize) -> LinkSet {
        if target == Some((own.system, own.component)) {
            return LinkSet::NONE;
        }
        self.toward(target, links).without(from_link)
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

    fn onward(routing: &Routing, target: Option<(u8, u8)>, from_link: u8) -> std::vec::Vec<u8> {
        routing.onward(OWN, target, from_link, 3).iter().collect()
    }

    #[test]
    fn broadcasts_go_everywhere_else_and_targeted_packets_where_their_target_was_seen_but_never_back() {
        let mut routing = Routing::default();
        for (component, link) in [(id(1, 191), 0), (id(245, 190), 1), (id(245, 190), 2)] {
            routing.note(1, component, link);
        }
        for (target, from_link, links) in [
            (None, 0, &[1, 2][..]),
            (Some((0, 0)), 2, &[0, 1]),
            (Some((1, 191)), 1, &[0]),
            (Some((1, 191)), 0, &[]),
            (Some((245, 190)), 0, &[1, 2]),
            (Some((9, 9)), 0, &[]),
            (Some((1, 1)), 2, &[]),
            // All components of the vehicle's system: the companion is one of them.
            (Some((1, 0)), 2, &[0]),
        ] {
            assert_eq!(onward(&routing, target, from_link), links, "{target:?}");
        }
    }

    #[test]
    fn made_up_senders_on_one_link_neither_grow_the_table_nor_displace_those_of_another() {
        let mut routing = Routing::default();
        routing.note(1, id(1, 191), 0);
        for i in 0..10_000_u32 {
            let [a, b, ..] = i.to_le_bytes();
            routing.note(2 + u64::from(i), id(a, b), 1);
        }
        let [a, b, ..] = 9999_u32.to_le_bytes();
        assert_eq!(onward(&routing, Some((a, b)), 0), [1], "the newest is known");
        let [a, b, ..] = 9000_u32.to_le_bytes();
        assert!(onward(&routing, Some((a, b)), 0).is_empty(), "an old one is forgotten");
        assert_eq!(onward(&routing, Some((1, 191)), 1), [0]);
    }

    #[test]
    fn a_link_beyond_the_last_is_neither_noted_nor_served() {
        let mut routing = Routing::default();
        routing.note(1, id(1, 191), 200);
        assert!(routing.toward(Some((1, 191)), 200).is_empty());
        assert_eq!(routing.toward(None, 200).iter().count(), MAX_LINKS);
    }
}
