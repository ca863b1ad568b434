//! Settings that are a choice among a few named values: what configuration files, the command line, MAVLink parameters and the
//! parts of the flight stack all call by the same names.

/// A setting with a few named values.
pub trait Choice: Copy + PartialEq + 'static {
    /// All values; the place of each is its number as a MAVLink parameter, and never changes meaning.
    const ALL: &'static [Self];
    /// For each value its name in configuration files and on the command line, and what it means.
    const WORDS: &'static [(&'static str, &'static str)];

    /// The number of this value.
    fn code(self) -> i32 {
        // A handful.
        Self::ALL.iter().position(|value| *value == self).unwrap_or(0) as i32
    }

    /// The name of this value.
    fn name(self) -> &'static str {
        let index = self.code() as usize;
        Self::WORDS.get(index).map_or("", |(name, _)| name)
    }

    /// The value of a number; `None` when there is none.
    fn from_code(code: i32) -> Option<Self> {
        Self::ALL.get(usize::try_from(code).ok()?).copied()
    }

    /// The value of a name; `None` when there is none.
    fn from_name(name: &str) -> Option<Self> {
        let index = Self::WORDS.iter().position(|(known, _)| *known == name)?;
        Self::ALL.get(index).copied()
    }
}

/// An enum of which each value has a name: of `Colour { Red => "red" }` the values `Colour::ALL`, in this order, and
/// `Colour::Red.name()`; `Colour::from_name` finds one again.
#[macro_export]
macro_rules! named {
    ($(#[$meta:meta])* $vis:vis enum $name:ident {
        $($(#[$of_value:meta])* $variant:ident $(= $number:literal)? => $word:literal,)+
    }) => {
        $(#[$meta])*
        $vis enum $name {
            $($(#[$of_value])* $variant $(= $number)?,)+
        }

        #[allow(dead_code, reason = "the same for all")]
        impl $name {
            /// All, in the order of their numbers.
            pub const ALL: [Self; [$($word),+].len()] = [$(Self::$variant),+];

            /// Name as it stands in files, reports, messages and documentation.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $word,)+
                }
            }

            /// The value of a name; `None` when there is none.
            pub fn from_name(name: &str) -> Option<Self> {
                Self::ALL.into_iter().find(|value| value.name() == name)
            }
        }
    };
}

macro_rules! choices {
    ($($(#[$meta:meta])* $name:ident {
        $($(#[$default:meta])? $variant:ident = $word:literal: $text:literal,)+
    })+) => {$(
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
        pub enum $name {
            $($(#[$default])? #[doc = $text] $variant,)+
        }

        impl Choice for $name {
            const ALL: &'static [Self] = &[$(Self::$variant),+];
            const WORDS: &'static [(&'static str, &'static str)] = &[$(($word, $text)),+];
        }

        #[cfg(feature = "files")]
        crate::value_setting!($name, crate::settings::choice, |value: &$name| value.name());
    )+};
}

choices! {
    /// Who starts a flight.
    EngagePolicy {
        Auto = "auto": "guidance, as soon as it is ready and no person has the vehicle (docs/guidance.md, \"Where auto engages\")",
        #[default]
        Command = "command": "an operator, by MAVLink",
    }

    /// Whose flight it is.
    Duty {
        #[default]
        Fly = "fly": "guidance flies to goals when it is engaged",
        JustStop = "just-stop": "somebody else flies; the vehicle is ordered to hold before it hits something (docs/just-stop.md)",
        FlyAround = "fly-around": "the same, and a mission that was stopped is flown around what is there and handed back",
    }

    /// What to do at the goal.
    AtGoal {
        #[default]
        Hold = "hold": "hover until there is another goal",
        Land = "land": "hover for 2 s, then land",
    }

    /// What to do about a vehicle that does not get nearer to its goal.
    OnNoProgress {
        Hold = "hold": "hover until there is another goal, or an operator engages",
        #[default]
        Land = "land": "hover for 10 s, in which an operator may give another goal, then land",
    }

    /// What a raised alarm brings about.
    AlarmPolicy {
        Ignore = "ignore": "it is reported; the flight is not touched",
        Stop = "stop": "the vehicle stops, and stays until the alarm has ended",
        #[default]
        Recover = "recover": "the vehicle stops, then the recovery pilot flies on until the alarm has ended",
    }

    /// When OBSTACLE_DISTANCE is sent. Frames from the ground see the ground: sent as obstacles they keep an autopilot that
    /// listens from arming.
    ObstacleReports {
        Off = "off": "never",
        #[default]
        Flight = "flight": "while the pilot looks and the vehicle is in the air",
        KeepAlive = "keep-alive": "the same; at any other time messages without a distance, for an autopilot that does not arm without",
    }

    /// Which autopilot the vehicle has.
    AutopilotChoice {
        #[default]
        Auto = "auto": "what its heartbeat names",
        Px4 = "px4": "PX4, and the simulator",
        ArduPilot = "ardupilot": "ArduPilot (Copter)",
    }

    /// What a flight log holds (docs/log.md, "What is recorded").
    LogContent {
        #[default]
        Everything = "everything": "frames, what a replay needs, what viewers draw",
        Replay = "replay": "frames and what a replay needs, without what viewers draw",
        Light = "light": "what viewers draw, with frames for people only: it cannot be replayed",
    }

    /// The pilots there are.
    PilotKind {
        Geometric = "geometric": "goal seeking and potential field on the depth frame",
        #[default]
        Actor = "actor": "the frozen actor",
    }

    /// What is taken from the actor, as a control: an actor that flies as well without it does not use it.
    Ablation {
        #[default]
        Nothing = "nothing": "the actor as it is",
        Frames = "frames": "every frame shows nothing",
        Memory = "memory": "surfaces out of view and the own trail are forgotten",
        Motion = "motion": "older scans, own motion and the last action are zero",
        Goal = "goal": "the goal is always 21 m ahead",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn each_value_is_found_by_its_name_and_its_number<T: Choice + core::fmt::Debug>() {
        assert_eq!(T::ALL.len(), T::WORDS.len());
        for (number, value) in (0..).zip(T::ALL) {
            assert_eq!(value.code(), number);
            assert_eq!(T::from_code(number), Some(*value));
            assert_eq!(T::from_name(value.name()), Some(*value));
        }
        assert_eq!(T::from_code(-1), None);
        assert_eq!(T::from_code(T::ALL.len() as i32), None);
        assert_eq!(T::from_name(""), None);
    }

    #[test]
    fn numbers_and_names_lead_back_to_their_values() {
        macro_rules! each {
            ($($choice:ident)+) => { $(each_value_is_found_by_its_name_and_its_number::<$choice>();)+ };
        }
        each! { EngagePolicy Duty AtGoal OnNoProgress AlarmPolicy ObstacleReports AutopilotChoice LogContent PilotKind Ablation }
        assert_eq!(AlarmPolicy::Recover.code(), 2, "DT_ALARM");
        assert_eq!(AtGoal::Land.code(), 1, "GD_AT_GOAL");
    }
}
