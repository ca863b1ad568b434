use super::*;
use std::collections::BTreeMap;

settings! {
    struct Whole {
        on: bool = &crate::parameters::TAKEN_OVER,
        guard: Option<bool> = &crate::parameters::GUARD,
        count: u8 = within(3, (1.0, 9.0), "steps"),
        gains: [f32; 2] = within([0.1, 0.5], (0.0, 1.0), ""),
        notes: BTreeMap<String, f64> = section(),
        place: Option<Place> = free(None),
        stops: Vec<Place> = section(),
    }

    struct Place {
        x_m: f64 = required(),
        y_m: f64 = free(1.5),
    }
}

#[test]
fn what_is_written_is_read_back_and_the_default_names_only_what_holds() {
    let mut whole = Whole::default();
    assert_eq!(to_toml(&whole), "count = 3\ngains = [0.1, 0.5]\n");
    for on in [false, true] {
        (whole.on, whole.guard) = (on, Some(on));
        assert_eq!(from_toml(&to_toml(&whole)), Ok(whole.clone()));
    }
    whole.notes.insert("a b".to_owned(), f64::NEG_INFINITY);
    whole.place = Some(Place::default());
    whole.stops = vec![Place { x_m: -0.0, y_m: 1e-300 }, Place { x_m: 7.0, y_m: 2.0 }];
    let text = to_toml(&whole);
    assert!(
        text.contains("\n[place]\n") && text.matches("\n[[stops]]\n").count() == 2,
        "{text}"
    );
    assert_eq!(from_toml(&text), Ok(whole));
}

#[test]
fn what_a_text_does_not_name_stays() {
    let mut whole = from_toml::<Whole>("count = 0x5\nplace.x_m = 4").unwrap();
    read_over(&mut whole, "place = { x_m = 5.0 }").unwrap();
    let place = Some(Place { x_m: 5.0, y_m: 1.5 });
    assert_eq!((whole.count, whole.place), (5, place));
}

#[test]
fn what_is_refused_is_reported_by_line_column_and_key_with_what_is_allowed() {
    for (text, reason) in [
        (
            "\ncount = 10",
            "line 2, column 9: `count`: 10 is not allowed: 1 to 9 steps",
        ),
        ("count = -1", "`count`: -1 is not allowed: 1 to 9 steps"),
        ("count = 2.5", "a whole number is needed"),
        ("gains = [0.5, 1.5]", "`gains`: 1.5 is not allowed: 0 to 1"),
        ("gains = [0.5]", "2 values are needed, not 1"),
        (
            "gains = [0.5, true]",
            "`gains[1]`: a number is needed, this is of type boolean",
        ),
        ("gains = [99999999999999999999]", "99999999999999999999 is too large"),
        ("on = -1", "true or false is needed"),
        ("guard = 3", "true or false is needed"),
        ("[place]\ny_m = 1", "line 1, column 1: `place`: `x_m` is missing"),
        (
            "[[stops]]\nx_m = 1\n[[stops]]\nx = 1",
            "line 4, column 1: `stops[1]`: there is no key `x` here, only `x_m`, `y_m`",
        ),
        ("stops = 1", "a list is needed"),
        ("place = 1", "a table is needed"),
        ("count = ", "line 1, column 9"),
        ("count = 1\ncount = 2", "line 2"),
    ] {
        let error = from_toml::<Whole>(text).unwrap_err();
        assert!(error.contains(reason), "{text}: {error}");
    }
}

#[test]
fn numbers_that_a_program_sets_are_checked_as_a_files_are() {
    let mut whole = Whole::default();
    assert_eq!(check(&whole), Ok(()));
    whole.gains[1] = f32::NAN;
    assert_eq!(check(&whole).unwrap_err().to_string(), "`gains` is NaN, must be 0 to 1");
}
