//! The words beside the plan: the course's numbers, what the colours mean, the flights.

use super::canvas::Canvas;
use super::{
    CORRIDOR, FAINT_INK, FlightPath, INK, LEFT, MESH, MOVER, OVERHANG, START, TALL_M, TOP, View, dashed, flown_under,
    line, path_colour, shade, text,
};
use crate::world::course::Course;
use crate::world::vehicle::VEHICLE;
use embedded_graphics::mono_font::iso_8859_1::{FONT_8X13, FONT_10X20};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::text::Alignment;

/// The legend names at most so many paths.
const LEGEND_PATHS: usize = 12;

pub(super) fn draw_legend(canvas: &mut Canvas, view: &View, course: &Course, paths: &[FlightPath]) {
    text(canvas, &course.name, [LEFT, 20.0], &FONT_10X20, INK, Alignment::Left);
    let x = view.at(0.0, view.east_m[1])[0] + 24.0;
    let mut y = TOP + 8.0;
    let ceiling = course.ceiling_height_m.map_or("none".to_owned(), |c| format!("{c} m"));
    for words in [
        format!("flight height {} m", course.flight_height_m),
        format!("ceiling       {ceiling}"),
        format!("goal radius   {} m", course.goal_radius_m),
        format!("time limit    {} s", course.time_limit_s),
    ] {
        text(canvas, &words, [x, y], &FONT_8X13, INK, Alignment::Left);
        y += 17.0;
    }
    y += 16.0;
    text(canvas, "obstacle height, m", [x, y], &FONT_8X13, INK, Alignment::Left);
    y += 12.0;
    let (bar, tall) = (160.0, 14.0);
    canvas.layer(1.0, |layer| {
        for k in 0..bar as usize {
            let at = x + k as f32;
            line(layer, [[at, y], [at, y + tall]], shade(TALL_M * k as f32 / bar), 2.0);
        }
    });
    for h in 0..=4 {
        let at = [x + bar * h as f32 / TALL_M, y + tall + 9.0];
        text(canvas, &h.to_string(), at, &FONT_8X13, FAINT_INK, Alignment::Center);
    }
    y += tall + 36.0;
    let width = 2.0 * (VEHICLE.radius_m + course.corridor_margin_m());
    let is_flown_under = course.overhangs.iter().any(|o| flown_under(course, &o.solid()));
    let entries: [(&str, Rgb888, f32, bool); 7] = [
        ("mesh, at flight height", MESH, 1.0, !course.meshes.is_empty()),
        ("wire, at flight height", MESH, 1.0, !course.wires.is_empty()),
        ("overhang, from-to m", OVERHANG, 0.6, !course.overhangs.is_empty()),
        ("flown under", OVERHANG, 0.25, is_flown_under),
        ("moving, speed m/s", MOVER, 1.0, !course.movers.is_empty()),
        (&format!("corridor, {width:.1} m"), CORRIDOR, 0.4, true),
        ("checkpoint", START, 1.0, !course.checkpoints.is_empty()),
    ];
    for (words, colour, opacity, _) in entries.iter().filter(|e| e.3) {
        canvas.layer(*opacity, |layer| {
            if *words == "checkpoint" {
                dashed(layer, [[x, y], [x + 22.0, y]], *colour, 1.6);
            } else {
                line(layer, [[x, y], [x + 22.0, y]], *colour, 12.0);
            }
        });
        text(canvas, words, [x + 32.0, y], &FONT_8X13, INK, Alignment::Left);
        y += 20.0;
    }
    y += 12.0;
    for (i, path) in paths.iter().enumerate().take(LEGEND_PATHS) {
        canvas.layer(1.0, |layer| {
            line(layer, [[x, y], [x + 22.0, y]], path_colour(path, i), 3.0)
        });
        let outcome = path.outcome.map_or(String::new(), |o| format!(": {o}"));
        let words: String = format!("{}{outcome}", path.label).chars().take(24).collect();
        text(canvas, &words, [x + 32.0, y], &FONT_8X13, INK, Alignment::Left);
        y += 20.0;
    }
    if paths.len() > LEGEND_PATHS {
        let more = format!("and {} more", paths.len() - LEGEND_PATHS);
        text(canvas, &more, [x + 32.0, y], &FONT_8X13, FAINT_INK, Alignment::Left);
    }
}
