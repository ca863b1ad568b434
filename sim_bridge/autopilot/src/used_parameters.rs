//! Which parameters of a command mean something. One that does not must be left out (NaN, or 0 as most clients send): PX4
//! refuses anything else since 2026, because it would be lost without a word.
//! <https://github.com/PX4/PX4-Autopilot/pull/27541>

use vigil_mavlink::framing::{Command, CommandForm};

/// Command and its parameters, in missions and as a command. A command that is not here is not looked at.
const USED: &[(u16, &[usize], &[usize])] = &[
    (16, &[1, 2, 4, 5, 6, 7], &[1, 2, 4, 5, 6, 7]),
    (17, &[3, 4, 5, 6, 7], &[]),
    // Ground stations and scripts give it a place, which is home's and the rally points' to say.
    (20, &[5, 6, 7], &[]),
    (21, &[1, 2, 4, 5, 6, 7], &[1, 2, 4, 5, 6, 7]),
    // Ground stations send a pitch in parameter 1 that multicopters do not use.
    (22, &[1, 4, 5, 6, 7], &[1, 4, 5, 6, 7]),
    (31, &[1, 2, 4, 5, 6, 7], &[1, 2, 4, 5, 6, 7]),
    (80, &[1, 2, 3, 5, 6, 7], &[1, 2, 3, 5, 6, 7]),
    (93, &[1, 2, 3, 4], &[1, 2, 3, 4]),
    (176, &[1, 2, 3], &[1, 2, 3]),
    (177, &[1, 2], &[1, 2]),
    (178, &[1, 2, 3], &[1, 2, 3]),
    (186, &[1, 2], &[1, 2]),
    (189, &[5, 6, 7], &[5, 6, 7]),
    (195, &[5, 6, 7], &[1, 5, 6, 7]),
    (196, &[1], &[1]),
    (197, &[1], &[1]),
    (201, &[1, 2, 3, 5, 6, 7], &[1, 2, 3, 5, 6, 7]),
    (206, &[1, 2, 3, 4], &[1, 2, 3, 4]),
    (211, &[1, 2], &[1, 2]),
    (214, &[1, 2, 3], &[1, 2, 3]),
    (400, &[1, 2], &[1, 2]),
    (420, &[1, 2, 3, 4], &[1, 2, 3, 4]),
    (530, &[1, 2], &[1, 2]),
    (532, &[1, 2, 3], &[1, 2, 3]),
    (2000, &[1, 2, 3, 4], &[1, 2, 3, 4]),
    (2001, &[1], &[1]),
    (2003, &[1, 2, 3, 4], &[1, 2, 3, 4]),
    (2500, &[1, 2, 3], &[1, 2, 3]),
    (2501, &[1, 2], &[1, 2]),
    (5001, &[1, 5, 6], &[1]),
    (5002, &[1, 5, 6], &[1]),
    (5003, &[1, 5, 6], &[1]),
    (5004, &[1, 5, 6], &[1]),
    (5100, &[5, 6, 7], &[]),
];

fn entry(number: u16) -> Option<&'static (u16, &'static [usize], &'static [usize])> {
    let index = USED.binary_search_by_key(&number, |entry| entry.0).ok()?;
    USED.get(index)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_sorted() {
        assert!(USED.is_sorted_by(|a, b| a.0 < b.0));
    }

    #[test]
    fn a_parameter_without_a_meaning_is_found_however_it_is_left_out() {
        let nan = f32::NAN;
        assert_eq!(misused_in_item(16, [0.0, 2.0, nan, nan], 1, 1, 5.0), None);
        assert_eq!(misused_in_item(16, [0.0, 2.0, 1.0, nan], 1, 1, 5.0), Some(3));
        assert_eq!(misused_in_item(20, [0.0; 4], i32::MIN, i32::MAX, 0.0), None);
        assert_eq!(misused_in_item(20, [0.0; 4], 0, 7, 5.0), None, "a return with a place");
        assert_eq!(misused_in_item(93, [0.0; 4], 0, 7, 0.0), Some(6));
        assert_eq!(misused_in_item(115, [9.0; 4], 7, 7, 7.0), None, "not looked at");
    }
}
