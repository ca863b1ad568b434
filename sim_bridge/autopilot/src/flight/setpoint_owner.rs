//! Offboard setpoints: whose are flown.
//!
//! One owner at a time: an identity, on the link and from the end of it where it was when it became the owner. Whoever
//! claims the same identity elsewhere is somebody else. The owner is chosen when OFFBOARD is entered: the sender of the mode
//! command if its own setpoints are fresh, else the only source whose setpoints are fresh. Everybody else's setpoints are
//! counted and ignored until OFFBOARD is left.

use crate::config::Source;
use crate::flight::setpoints::SetpointDefect;
use crate::vehicle::ControlCommand;
use vigil_types::Nanos;

/// Sources remembered; the oldest gives way. So many that a flood of made-up ones does not come between a setpoint and the
/// mode command behind it.
const MAX_SOURCES: usize = 64;

#[derive(Debug, Clone, Copy)]
struct SourceState {
    id: Source,
    last_ns: Nanos,
    command: ControlCommand,
    /// A status text has said that its setpoints are ignored.
    is_warned: bool,
}

/// The newest setpoint of each source, and who owns OFFBOARD.
#[derive(Debug, Default)]
pub(crate) struct Setpoints {
    sources: Vec<SourceState>,
    /// Whose setpoints are flown.
    pub owner: Option<Source>,
    /// The last that was refused, and when.
    pub refused: Option<(Nanos, SetpointDefect)>,
}

impl Setpoints {
    /// The owner's setpoint, if it is fresh.
    pub fn current(&self, now_ns: Nanos, max_age_ns: Nanos) -> Option<ControlCommand> {
        let owner = self.owner?;
        let state = self.sources.iter().find(|s| s.id == owner)?;
        (now_ns.saturating_sub(state.last_ns) <= max_age_ns).then_some(state.command)
    }

    /// Takes a source's newest setpoint. One that is ignored, because somebody else owns OFFBOARD, gives whether its sender has been
    /// warned already.
    pub fn take(&mut self, now_ns: Nanos, id: Source, command: ControlCommand) -> Option<bool> {
        let owner = self.owner;
        if let Some(source) = self.sources.iter_mut().find(|s| s.id == id) {
            source.last_ns = now_ns;
            source.command = command;
        } else {
            let source = SourceState {
                id,
                last_ns: now_ns,
                command,
                is_warned: false,
            };
            if self.sources.len() < MAX_SOURCES {
                self.sources.push(source);
            } else {
                let others = self.sources.iter_mut().filter(|s| Some(s.id) != owner);
                others.min_by_key(|s| s.last_ns).into_iter().for_each(|s| *s = source);
            }
        }
        owner.filter(|owner| *owner != id)?;
        let source = self.sources.iter_mut().find(|s| s.id == id);
        Some(source.is_none_or(|s| std::mem::replace(&mut s.is_warned, true)))
    }

    /// Whose setpoints are fresh.
    pub fn streaming(&self, now_ns: Nanos, max_age_ns: Nanos) -> impl Iterator<Item = Source> {
        let is_fresh = move |s: &&SourceState| now_ns.saturating_sub(s.last_ns) <= max_age_ns;
        self.sources.iter().filter(is_fresh).map(|s| s.id)
    }

    /// Who could own OFFBOARD on a mode command of `commander`: it alone where it streams, else everybody who does.
    pub fn claims(&self, now_ns: Nanos, max_age_ns: Nanos, commander: Source) -> Vec<Source> {
        let mut streaming: Vec<Source> = self.streaming(now_ns, max_age_ns).collect();
        if streaming.contains(&commander) {
            return vec![commander];
        }
        streaming.sort_unstable();
        streaming
    }

    /// Sets or clears the owner.
    pub fn set_owner(&mut self, owner: Option<Source>) {
        self.owner = owner;
        for source in &mut self.sources {
            source.is_warned = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(system: u8) -> Source {
        Source {
            link: crate::LinkId::ONBOARD,
            peer: 0,
            id: vigil_mavlink::routing::ComponentId { system, component: 1 },
        }
    }

    #[test]
    fn a_flood_of_sources_never_evicts_the_owner() {
        let mut setpoints = Setpoints::default();
        setpoints.take(0, id(2), ControlCommand::Idle);
        setpoints.set_owner(Some(id(2)));
        for n in 3..=255 {
            let taken = setpoints.take(u64::from(n), id(n), ControlCommand::MotorsOff);
            assert_eq!(taken, Some(false));
        }
        assert_eq!(setpoints.current(300, 400), Some(ControlCommand::Idle));
        assert_eq!(setpoints.sources.len(), MAX_SOURCES);
    }
}
