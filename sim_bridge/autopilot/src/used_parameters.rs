//! Which parameters of a command mean something. One that does not must be left out (NaN, or 0 as most clients send): PX4
//! refuses anything else since 2026, because it would be lost without a word.
//! <https://github.com/PX4/PX4-Autopilot/pull/27541>

use vigil_mavlink::framing::{Command, CommandForm};

/// Commands with their parameters, in missions and as a command. A command that is not here is not looked at.
const USED: &[(&[u16], &[usize], &[usize])] = &[
    (&[16, 21, 31], &[1, 2, 4, 5, 6, 7], &[1, 2, 4, 5, 6, 7]),
    (&[17], &[3, 4, 5, 6, 7], &[]),
    // Ground stations and scripts give the return a place, which is home's and the rally points' to say.
    (&[20, 5100], &[5, 6, 7], &[]),
    // Ground stations send a pitch in parameter 1 that multicopters do not use.
    (&[22], &[1, 4, 5, 6, 7], &[1, 4, 5, 6, 7]),
    (&[80, 201], &[1, 2, 3, 5, 6, 7], &[1, 2, 3, 5, 6, 7]),
    (&[93, 206, 420, 2000, 2003], &[1, 2, 3, 4], &[1, 2, 3, 4]),
    (&[176, 178, 214, 532, 2500], &[1, 2, 3], &[1, 2, 3]),
    (&[177, 186, 211, 400, 530, 2501], &[1, 2], &[1, 2]),
    (&[189], &[5, 6, 7], &[5, 6, 7]),
    (&[195], &[5, 6, 7], &[1, 5, 6, 7]),
    (&[196, 197, 2001], &[1], &[1]),
    (&[5001, 5002, 5003, 5004], &[1, 5, 6], &[1]),
];

fn entry(number: u16) -> Option<&'static (&'static [u16], &'static [usize], &'static [usize])> {
    USED.iter().find(|(numbers, ..)| numbers.contains(&number))
}

fn is_left_out(value: f32) -> bool {
    value.is_nan() || value == 0.0
}

/// What clients leave in an integer parameter that they do not use: a NaN that was cast becomes the smallest.
fn is_left_out_integer(value: i32) -> bool {
    matches!(value, 0 | i32::MAX | i32::MIN)
}

/// The first parameter of a mission item that holds something although its command does not use it.
pub(crate) fn misused_in_item(number: u16, params: [f32; 4], x: i32, y: i32, z: f32) -> Option<usize> {
    let (_, used, _) = entry(number)?;
    let floats = params.into_iter().enumerate().map(|(i, p)| (i + 1, is_left_out(p)));
    let place = [
        (5, is_left_out_integer(x)),
        (6, is_left_out_integer(y)),
        (7, is_left_out(z)),
    ];
    floats
        .chain(place)
        .find_map(|(number, is_left_out)| (!is_left_out && !used.contains(&number)).then_some(number))
}

/// The same for a command.
pub(crate) fn misused_in_command(command: &Command) -> Option<usize> {
    let (_, _, used) = entry(command.number)?;
    (1..=7).find(|number| {
        let is_left_out = match (command.form, *number) {
            (CommandForm::Int { x, .. }, 5) => is_left_out_integer(x),
            (CommandForm::Int { y, .. }, 6) => is_left_out_integer(y),
            _ => command.param(*number).is_none_or(is_left_out),
        };
        !is_left_out && !used.contains(number)
    })
}
