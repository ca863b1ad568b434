//! A shell over SERIAL_CONTROL, device 10. <https://mavlink.io/en/messages/common.html#SERIAL_CONTROL>
//!
//! A few commands of PX4's shell, by the same paths as the messages that do the same: a shell can do nothing that a
//! message could not.

use crate::core::padded;
use crate::files::Entry;
use crate::flight::{Denial, FlightMode};
use crate::plan::PlanKind;
use crate::service::prelude::*;
use crate::services::actions;
use crate::services::parameters::value_message;
use crate::vehicle_parameters::{ParameterError, ParameterValue, Parameters};

/// Bytes of a packet.
const CHUNK: usize = 70;
/// Longest line; a longer one is forgotten.
const MAX_LINE: usize = 256;
/// Clients whose unfinished lines are kept; the oldest gives way.
const MAX_CLIENTS: usize = 8;
/// The prompt of PX4's simulation, which scripts wait for.
const PROMPT: &str = "pxh> ";

const HELP: &str = "\
commander status | arm | disarm | takeoff | land
commander mode hold | takeoff | land | return | mission | follow | offboard |
    position | altitude | stabilized | manual | acro
help
ls [DIRECTORY]
mission
param show [PATTERN]      names with * for anything
param set NAME VALUE
reboot                    on the ground only
uptime
ver
";

#[derive(Default)]
pub(crate) struct Shell {
    /// What each client has written since its last line end.
    lines: Vec<(Source, Vec<u8>)>,
}

impl Service for Shell {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        let Some(message) = core.read::<SERIAL_CONTROL_DATA>(packet) else {
            return;
        };
        let flags = message.flags;
        // What another's shell answers is nothing to obey.
        if message.device != SerialControlDev::SERIAL_CONTROL_DEV_SHELL
            || flags.contains(SerialControlFlag::SERIAL_CONTROL_FLAG_REPLY)
        {
            return;
        }
        let bytes = message.data.get(..usize::from(message.count)).unwrap_or(&message.data);
        let mut output = String::new();
        for byte in bytes {
            self.take(*byte, source, core, &mut output);
        }
        if flags.contains(SerialControlFlag::SERIAL_CONTROL_FLAG_RESPOND) {
            reply(&output, source, core);
        }
    }
}

fn reply(output: &str, client: Source, core: &mut Core) {
    for chunk in output.as_bytes().chunks(CHUNK) {
        let message = message!(
            SERIAL_CONTROL,
            device = SerialControlDev::SERIAL_CONTROL_DEV_SHELL,
            flags = SerialControlFlag::SERIAL_CONTROL_FLAG_REPLY,
            count = chunk.len() as u8,
            data = padded::<CHUNK>(chunk)
        );
        core.outbox.send_to(client, message);
    }
}

impl Shell {
    fn take(&mut self, byte: u8, client: Source, core: &mut Core, output: &mut String) {
        if byte != b'\n' && byte != b'\r' {
            let line = self.line(client);
            // One more than fits marks a line that is too long.
            if line.len() <= MAX_LINE {
                line.push(byte);
            }
            return;
        }
        let line = std::mem::take(self.line(client));
        self.lines.retain(|(of, _)| *of != client);
        let text = match core::str::from_utf8(&line) {
            _ if line.len() > MAX_LINE => "line too long\n".to_owned(),
            Ok(text) => execute(text.trim(), client, core),
            Err(_) => "not text\n".to_owned(),
        };
        output.push_str(&text);
        output.push_str(PROMPT);
    }

    fn line(&mut self, client: Source) -> &mut Vec<u8> {
        let index = self.lines.iter().position(|(of, _)| *of == client).unwrap_or_else(|| {
            if self.lines.len() >= MAX_CLIENTS {
                self.lines.remove(0);
            }
            self.lines.push((client, Vec::new()));
            self.lines.len() - 1
        });
        &mut self.lines[index].1
    }
}

/// Does what a line says and returns what came of it.
fn execute(line: &str, client: Source, core: &mut Core) -> String {
    let words: Vec<&str> = line.split_whitespace().collect();
    match words.as_slice() {
        [] => String::new(),
        ["help" | "?"] => HELP.to_owned(),
        ["ver", ..] => format!("Vigil {}\n", env!("CARGO_PKG_VERSION")),
        ["uptime"] => format!("{:.3} s\n", core.since_boot_ns() as f64 * 1e-9),
        ["commander", "status"] => commander_status(core),
        ["commander", "arm"] => outcome(core.arm(client)),
        ["commander", "disarm"] => outcome(core.disarm(false)),
        ["commander", "takeoff"] => {
            let taken_off = core.take_off(None).and_then(|()| core.arm(client));
            outcome(taken_off)
        }
        ["commander", "land"] => outcome(core.change_mode(FlightMode::Land, client)),
        ["commander", "mode", name] => match FlightMode::from_name(name).filter(|mode| mode.is_commanded()) {
            Some(mode) => outcome(core.change_mode(mode, client)),
            None => format!("no mode {name} that can be commanded; see help\n"),
        },
        ["param", "show"] => show("*", core),
        ["param", "show", pattern] => show(pattern, core),
        ["param", "set", name, value] => set(name, value, core),
        ["mission", ..] => mission_status(core),
        ["ls"] => list("", core),
        ["ls", path] => list(path, core),
        ["reboot"] => match actions::reboot_now(core) {
            Ok(()) => "rebooted\n".to_owned(),
            Err(_) => "refused: not disarmed\n".to_owned(),
        },
        [command, ..] => format!("{command}: unknown; try help\n"),
    }
}

fn outcome(outcome: Result<(), Denial>) -> String {
    match outcome {
        Ok(()) => "done\n".to_owned(),
        Err(denial) => format!("refused: {denial}\n"),
    }
}

fn commander_status(core: &Core) -> String {
    let c = &core.commander;
    let owner = core.setpoints.owner.map_or("none".to_owned(), |id| id.to_string());
    let failsafe = c.failsafe.map_or("none".to_owned(), |f| format!("{f:?}"));
    format!(
        "armed: {}\nmode: {}\nlanded: {:?}\nfailsafe: {failsafe}\nterminated: {}\nsetpoint owner: {owner}\n",
        c.armed,
        c.mode.name(),
        c.landed,
        c.terminated,
    )
}

/// Whether `name` is what `pattern`, with `*` for anything, describes.
fn fits(name: &str, pattern: &str) -> bool {
    let Some((head, rest)) = pattern.split_once('*') else {
        return name == pattern;
    };
    let Some(name) = name.strip_prefix(head) else {
        return false;
    };
    (0..=name.len()).any(|from| name.get(from..).is_some_and(|tail| fits(tail, rest)))
}

fn show(pattern: &str, core: &Core) -> String {
    // Each star multiplies what is tried.
    if pattern.matches('*').count() > 3 {
        return "at most three *\n".to_owned();
    }
    let fitting = core.parameters.all().filter(|(info, _)| fits(info.name, pattern));
    let lines = fitting.map(|(info, value)| match value {
        ParameterValue::Integer(value) => format!("{}: {value}\n", info.name),
        ParameterValue::Real(value) => format!("{}: {value:?}\n", info.name),
    });
    let text: String = lines.collect();
    match text.is_empty() {
        true => format!("no parameter {pattern}\n"),
        false => text,
    }
}

fn set(name: &str, value: &str, core: &mut Core) -> String {
    match try_set(name, value, core) {
        Ok(()) => show(name, core),
        Err(why) => {
            core.refusals.parameter += 1;
            format!("{why}\n")
        }
    }
}

fn try_set(name: &str, value: &str, core: &mut Core) -> Result<(), String> {
    let unknown = || ParameterError::Unknown(name.to_owned()).to_string();
    let index = Parameters::index_of(name).ok_or_else(unknown)?;
    let parsed = match core.parameters.at(index) {
        Some((_, ParameterValue::Integer(_))) => value.parse().ok().map(ParameterValue::Integer),
        _ => value.parse().ok().map(ParameterValue::Real),
    };
    let parsed = parsed.ok_or_else(|| format!("{value}: not a number of the parameter's type"))?;
    core.parameters.set(index, parsed).map_err(|error| error.to_string())?;
    if let Some(message) = value_message(core, index) {
        core.outbox.send_all(&message);
    }
    Ok(())
}

fn list(path: &str, core: &Core) -> String {
    let line = |(name, entry): (&str, &Entry)| match entry.size() {
        Some(size) => format!("{size:>8} {name}\n"),
        None => format!("{:>8} {name}/\n", ""),
    };
    match core.files.list(path) {
        Err(error) => format!("{path}: {error}\n"),
        Ok(entries) => entries.into_iter().map(line).collect(),
    }
}

fn mission_status(core: &Core) -> String {
    let items = core.plans.wire(PlanKind::Mission).items.len();
    match items {
        0 => "no mission\n".to_owned(),
        _ => format!("item {} of {items}\n", core.plans.mission.current()),
    }
}
