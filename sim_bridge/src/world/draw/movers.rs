//! Obstacles that move: where they are at time zero, and their ways as double arrows.

use super::canvas::Canvas;
use super::{FONT_6X10, INK, MOVER, View, arrow, draw_solid, text};
use crate::world::course::Course;
use embedded_graphics::text::Alignment;

pub(super) fn draw_movers(canvas: &mut Canvas, view: &View, course: &Course) {
    for mover in &course.movers {
        let [from, to] = [mover.from_m, mover.to_m].map(|[north_m, east_m]| view.at(north_m, east_m));
        let middle = [0, 1].map(|k| 0.5 * (from[k] + to[k]));
        canvas.layer(1.0, |layer| {
            draw_solid(layer, view, &mover.solid_at(0), MOVER, INK);
        });
        canvas.layer(0.8, |layer| {
            arrow(layer, middle, from, MOVER);
            arrow(layer, middle, to, MOVER);
        });
        let words = format!("{:.2}", mover.speed_m_s);
        let above = [middle[0], middle[1] - 10.0];
        text(canvas, &words, above, &FONT_6X10, INK, Alignment::Center);
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FlightPath, MOVER, draw};
    use crate::world::Image;
    use embedded_graphics::prelude::RgbColor;

    fn pixels(image: &Image, colour: [u8; 3]) -> usize {
        image.rgb().chunks_exact(3).filter(|p| **p == colour).count()
    }

    #[test]
    fn a_mover_is_drawn_with_its_way() {
        let course = |mover: &str| crate::testing::field(0.0, 8.0, mover);
        let with = course(
            "[[mover]]\nfrom_m = [10.0, -5.0]\nto_m = [10.0, 5.0]\nspeed_m_s = 0.5\nheight_m = 2.0\n\
             shape = { column = { radius_m = 0.4 } }",
        );
        let none: [FlightPath; 0] = [];
        let colour = [MOVER.r(), MOVER.g(), MOVER.b()];
        assert_eq!(pixels(&draw(&course(""), &none), colour), 0);
        // A disc of 0.8 m at 32 pixels a metre has 515 pixels; the arrow, a little transparent, adds none of the same colour.
        let solid = pixels(&draw(&with, &none), colour);
        assert!((300..900).contains(&solid), "{solid}");
    }
}
