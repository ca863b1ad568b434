//! A course seen from above, as a picture. North is up.

mod canvas;
mod legend;

pub use canvas::{Image, ImageError, check_png_name};

use crate::world::course::Course;
use crate::world::referee::Outcome;
use crate::world::solid::Solid;
use crate::world::vehicle::VEHICLE;
use canvas::{Canvas, Layer, hex};
use embedded_graphics::mono_font::iso_8859_1::{FONT_6X10, FONT_8X13};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Circle, Line, PrimitiveStyle, PrimitiveStyleBuilder, Triangle};
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};
use vigil_types::NedVector;

/// A flight to draw over a course.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightPath {
    /// What the legend calls it.
    pub label: String,
    /// Where the vehicle was, in metres from home.
    pub points_ned_m: Vec<NedVector>,
    /// How it ended; fixes the colour, where known.
    pub outcome: Option<Outcome>,
}

const BACKGROUND: Rgb888 = Rgb888::new(250, 249, 246);
const GRID: Rgb888 = Rgb888::new(232, 230, 224);
const GRID_5M: Rgb888 = Rgb888::new(208, 205, 197);
const INK: Rgb888 = Rgb888::new(52, 54, 60);
const FAINT_INK: Rgb888 = Rgb888::new(128, 128, 130);
const CORRIDOR: Rgb888 = Rgb888::new(122, 190, 140);
const GOAL: Rgb888 = Rgb888::new(206, 142, 20);
const START: Rgb888 = Rgb888::new(38, 104, 184);
/// Obstacles run from the first colour at 0 m to the second at [`TALL_M`].
const LOW: Rgb888 = Rgb888::new(222, 208, 196);
const TALL: Rgb888 = Rgb888::new(92, 68, 58);
const TALL_M: f32 = 4.0;
const OVERHANG: Rgb888 = Rgb888::new(128, 96, 168);
const MOVER: Rgb888 = Rgb888::new(226, 88, 120);
const MESH: Rgb888 = Rgb888::new(88, 124, 128);
const UNKNOWN_PATHS: [Rgb888; 4] = [
    Rgb888::new(24, 118, 210),
    Rgb888::new(0, 140, 136),
    Rgb888::new(142, 60, 180),
    Rgb888::new(90, 90, 96),
];

/// Room around the plan: left for the axis, above for the title, right for the legend, below for the axis.
const LEFT: f32 = 52.0;
const TOP: f32 = 52.0;
const RIGHT: f32 = 236.0;
const BOTTOM: f32 = 44.0;
/// The longer side of the plan in pixels.
const PLAN_PIXELS: f32 = 960.0;

/// Draws the top view of a course: obstacles shaded by height, movers at time zero with their ways, start, goal, bounds,
/// checkpoints, the corridor, and flights.
pub fn draw(course: &Course, paths: &[FlightPath]) -> Image {
    on_canvas(course, paths).image
}

/// The same picture as an SVG file's content.
pub fn draw_svg(course: &Course, paths: &[FlightPath]) -> String {
    on_canvas(course, paths).to_svg()
}

fn on_canvas(course: &Course, paths: &[FlightPath]) -> Canvas {
    let view = View::of(course);
    let mut canvas = Canvas::new(view.width, view.height, BACKGROUND);
    draw_grid(&mut canvas, &view, course);
    draw_corridor(&mut canvas, &view, course);
    draw_obstacles(&mut canvas, &view, course);
    draw_movers(&mut canvas, &view, course);
    draw_places(&mut canvas, &view, course);
    canvas.layer(0.9, |layer| {
        for (i, path) in paths.iter().enumerate() {
            draw_path(layer, &view, path, path_colour(path, i));
        }
    });
    draw_labels(&mut canvas, &view, course);
    legend::draw_legend(&mut canvas, &view, course, paths);
    canvas
}

/// How metres become pixels.
struct View {
    north_m: [f32; 2],
    east_m: [f32; 2],
    pixels_per_m: f32,
    width: usize,
    height: usize,
}

impl View {
    fn of(course: &Course) -> Self {
        let (north_m, east_m) = (course.bounds.north_m, course.bounds.east_m);
        let (tall_m, wide_m) = (north_m[1] - north_m[0], east_m[1] - east_m[0]);
        let pixels_per_m = PLAN_PIXELS / tall_m.max(wide_m);
        // A strip too thin to hold the legend is widened below.
        let height = (TOP + BOTTOM + tall_m * pixels_per_m).max(560.0) as usize;
        let width = (LEFT + RIGHT + wide_m * pixels_per_m).max(480.0) as usize;
        Self {
            north_m,
            east_m,
            pixels_per_m,
            width,
            height,
        }
    }

    fn at(&self, north_m: f32, east_m: f32) -> [f32; 2] {
        [
            LEFT + (east_m - self.east_m[0]) * self.pixels_per_m,
            TOP + (self.north_m[1] - north_m) * self.pixels_per_m,
        ]
    }
}

fn fill(colour: Rgb888) -> PrimitiveStyle<Rgb888> {
    PrimitiveStyle::with_fill(colour)
}

fn stroke(layer: &Layer, colour: Rgb888, pixels: f32) -> PrimitiveStyle<Rgb888> {
    PrimitiveStyle::with_stroke(colour, layer.length(pixels))
}

/// Drawing in memory cannot fail.
fn drawn<T>(result: Result<T, core::convert::Infallible>) -> T {
    match result {
        Ok(value) => value,
        Err(never) => match never {},
    }
}

fn line(layer: &mut Layer, ends: [[f32; 2]; 2], colour: Rgb888, pixels: f32) {
    let [from, to] = ends.map(|end| layer.point(end));
    let shape = Line::new(from, to);
    drawn(shape.into_styled(stroke(layer, colour, pixels)).draw(layer));
    let [[x0, y0], [x1, y1]] = ends;
    let colour = hex(colour);
    layer.svg += &format!(
        "<line x1=\"{x0:.1}\" y1=\"{y0:.1}\" x2=\"{x1:.1}\" y2=\"{y1:.1}\" stroke=\"{colour}\" stroke-width=\"{pixels}\"/>\n"
    );
}

fn dashed(layer: &mut Layer, [from, to]: [[f32; 2]; 2], colour: Rgb888, pixels: f32) {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let length = libm::hypotf(dx, dy).max(1e-3);
    let (on, off) = (7.0, 6.0);
    let mut start = 0.0;
    while start < length {
        let end = (start + on).min(length);
        let at = |s: f32| [from[0] + dx * s / length, from[1] + dy * s / length];
        line(layer, [at(start), at(end)], colour, pixels);
        start = end + off;
    }
}

fn disc(layer: &mut Layer, centre: [f32; 2], radius: f32, style: PrimitiveStyle<Rgb888>) {
    let shape = Circle::with_center(layer.point(centre), layer.length(2.0 * radius));
    drawn(shape.into_styled(style).draw(layer));
    let [x, y] = centre;
    let or_none = |colour: Option<Rgb888>| colour.map_or("none".to_owned(), hex);
    layer.svg += &format!(
        "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" fill=\"{}\" stroke=\"{}\" stroke-width=\"{:.1}\"/>\n",
        or_none(style.fill_color),
        or_none(style.stroke_color),
        layer.pixels(style.stroke_width)
    );
}

/// A filled convex polygon.
fn polygon(layer: &mut Layer, corners: &[[f32; 2]], colour: Rgb888) {
    let points: Vec<String> = corners.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
    layer.svg += &format!("<polygon points=\"{}\" fill=\"{}\"/>\n", points.join(" "), hex(colour));
    let corners: Vec<Point> = corners.iter().map(|p| layer.point(*p)).collect();
    for [b, c] in corners[1..].array_windows() {
        drawn(Triangle::new(corners[0], *b, *c).into_styled(fill(colour)).draw(layer));
    }
}

/// A cross whose arms reach so far to each side.
fn cross(layer: &mut Layer, [x, y]: [f32; 2], reach: f32, colour: Rgb888) {
    for rises in [reach, -reach] {
        line(layer, [[x - reach, y - rises], [x + reach, y + rises]], colour, 3.0);
    }
}

/// A thick line through points, with round joints.
fn band(layer: &mut Layer, points: &[[f32; 2]], colour: Rgb888, pixels: f32) {
    for segment in points.windows(2) {
        let (dx, dy) = (segment[1][0] - segment[0][0], segment[1][1] - segment[0][1]);
        let half = 0.5 * pixels / libm::hypotf(dx, dy).max(1e-3);
        let beside = |p: [f32; 2]| [1.0, -1.0].map(|s: f32| [p[0] - s * half * dy, p[1] + s * half * dx]);
        let ([a, b], [d, c]) = (beside(segment[0]), beside(segment[1]));
        polygon(layer, &[a, b, c, d], colour);
    }
    for p in points {
        disc(layer, *p, 0.5 * pixels, fill(colour));
    }
}

fn text(canvas: &mut Canvas, words: &str, [x, y]: [f32; 2], font: &MonoFont<'_>, colour: Rgb888, alignment: Alignment) {
    let style = TextStyleBuilder::new()
        .alignment(alignment)
        .baseline(Baseline::Middle)
        .build();
    let at = Point::new(x.round() as i32, y.round() as i32);
    drawn(Text::with_text_style(words, at, MonoTextStyle::new(font, colour), style).draw(&mut canvas.image));
    let anchor = match alignment {
        Alignment::Left => "start",
        Alignment::Center => "middle",
        Alignment::Right => "end",
    };
    let words = words.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    canvas.svg += &format!(
        "<text x=\"{x:.1}\" y=\"{y:.1}\" font-family=\"monospace\" font-size=\"{}\" text-anchor=\"{anchor}\" dominant-baseline=\"central\" fill=\"{}\" xml:space=\"preserve\">{words}</text>\n",
        font.character_size.height,
        hex(colour)
    );
}

fn draw_grid(canvas: &mut Canvas, view: &View, course: &Course) {
    let (north, east) = (view.north_m, view.east_m);
    let metres = |range: [f32; 2]| (range[0].ceil() as i32)..=(range[1].floor() as i32);
    // Large courses get no line per metre.
    let step = if view.pixels_per_m < 12.0 { 5 } else { 1 };
    canvas.layer(1.0, |layer| {
        for fives in [false, true] {
            let colour = if fives { GRID_5M } else { GRID };
            for n in metres(north).filter(|n| n % step == 0 && (n % 5 == 0) == fives) {
                line(layer, east.map(|e| view.at(n as f32, e)), colour, 1.0);
            }
            for e in metres(east).filter(|e| e % step == 0 && (e % 5 == 0) == fives) {
                line(layer, north.map(|n| view.at(n, e as f32)), colour, 1.0);
            }
        }
        for c in &course.checkpoints {
            let across = crate::world::solid::radians(c.heading_deg + 90.0);
            let (dn, de) = (3.0 * libm::cosf(across), 3.0 * libm::sinf(across));
            let ends = [-1.0, 1.0].map(|s| view.at(c.north_m + s * dn, c.east_m + s * de));
            dashed(layer, ends, START, 1.3);
        }
        let corners = [(0, 0), (0, 1), (1, 1), (1, 0), (0, 0)].map(|(i, j)| view.at(north[i], east[j]));
        band(layer, &corners, INK, 2.0);
    });
    let mut label = |words: &str, at, side| text(canvas, words, at, &FONT_8X13, FAINT_INK, side);
    let label_step = if view.pixels_per_m < 12.0 { 20 } else { 5 };
    for n in metres(north).filter(|n| n % label_step == 0) {
        let [x, y] = view.at(n as f32, east[0]);
        label(&n.to_string(), [x - 8.0, y], Alignment::Right);
    }
    for e in metres(east).filter(|e| e % label_step == 0) {
        let [x, y] = view.at(north[0], e as f32);
        label(&e.to_string(), [x, y + 13.0], Alignment::Center);
    }
    let [x, y] = view.at(north[0], 0.5 * (east[0] + east[1]));
    label("east of home, m", [x, y + 31.0], Alignment::Center);
    label("north, m", [6.0, TOP - 14.0], Alignment::Left);
}

fn draw_corridor(canvas: &mut Canvas, view: &View, course: &Course) {
    let Some(way) = course.corridor() else {
        return;
    };
    let points: Vec<[f32; 2]> = way.iter().map(|[n, e]| view.at(*n, *e)).collect();
    let width = 2.0 * (VEHICLE.radius_m + course.corridor_margin_m()) * view.pixels_per_m;
    canvas.layer(0.22, |layer| band(layer, &points, CORRIDOR, width));
    canvas.layer(1.0, |layer| {
        for segment in points.array_windows() {
            dashed(layer, *segment, CORRIDOR, 2.0);
        }
    });
}

/// The colour of an obstacle's top at a height above ground.
fn shade(top_m: f32) -> Rgb888 {
    let f = (top_m / TALL_M).clamp(0.0, 1.0);
    let mix = |low: u8, tall: u8| (f32::from(low) + f * (f32::from(tall) - f32::from(low))).round() as u8;
    Rgb888::new(mix(LOW.r(), TALL.r()), mix(LOW.g(), TALL.g()), mix(LOW.b(), TALL.b()))
}

/// The four corners of a cuboid in the plan view, in pixels.
fn corners(view: &View, solid: &Solid) -> Option<[[f32; 2]; 4]> {
    let outline = solid.plan_rectangle()?;
    Some(outline.corners().map(|[north_m, east_m]| view.at(north_m, east_m)))
}

fn draw_solid(layer: &mut Layer, view: &View, solid: &Solid, colour: Rgb888, outline: Rgb888) {
    match corners(view, solid) {
        Some(c) => {
            polygon(layer, &c, colour);
            for i in 0..4 {
                line(layer, [c[i], c[(i + 1) % 4]], outline, 1.2);
            }
        }
        None => {
            let style = PrimitiveStyleBuilder::new()
                .fill_color(colour)
                .stroke_color(outline)
                .stroke_width(layer.length(1.2))
                .build();
            let (centre, (radius_m, _)) = (solid.centre_ned_m(), solid.plan_half_extents_m());
            disc(layer, view.at(centre.x, centre.y), radius_m * view.pixels_per_m, style);
        }
    }
}

fn draw_obstacles(canvas: &mut Canvas, view: &View, course: &Course) {
    canvas.layer(1.0, |layer| {
        // As the corridor has them: where they are at the heights that it needs.
        let reach_m = course.corridor_reach_m();
        let meshes = course.mesh_boxes(reach_m);
        for c in meshes.iter().filter_map(|b| corners(view, b)) {
            polygon(layer, &c, MESH);
        }
        let [low_m, high_m] = course.band_m(reach_m);
        for wire in &course.wires {
            let ends = [wire.from_m, wire.to_m].map(|[north_m, east_m, _]| view.at(north_m, east_m));
            line(layer, ends, GRID_5M, 1.2);
            let within = wire.between(low_m, high_m);
            if let Some([a, _, c, _]) = within.and_then(|part| corners(view, &part)) {
                line(layer, [a, c], MESH, 1.6);
            }
        }
        let standing = course.columns.len() + course.boxes.len() + course.walls.len();
        for solid in &course.solids()[..standing] {
            draw_solid(layer, view, solid, shade(solid.top_m()), INK);
        }
    });
    // Overhangs let what is below them show through.
    for overhang in &course.overhangs {
        let solid = overhang.solid();
        let opacity = if flown_under(course, &solid) { 0.25 } else { 0.6 };
        canvas.layer(opacity, |layer| draw_solid(layer, view, &solid, OVERHANG, OVERHANG));
        if let Some(c) = corners(view, &solid) {
            canvas.layer(1.0, |layer| {
                for i in 0..4 {
                    dashed(layer, [c[i], c[(i + 1) % 4]], OVERHANG, 1.6);
                }
            });
        }
    }
}

/// Obstacles that move: where they are at time zero, and their ways as double arrows.
fn draw_movers(canvas: &mut Canvas, view: &View, course: &Course) {
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

fn flown_under(course: &Course, solid: &Solid) -> bool {
    solid.bottom_m() >= course.flight_height_m + 0.5 * VEHICLE.height_m
}

fn draw_places(canvas: &mut Canvas, view: &View, course: &Course) {
    let goal = view.at(course.goal.north_m, course.goal.east_m);
    let start = view.at(course.start.north_m, course.start.east_m);
    let goal_radius = course.goal_radius_m * view.pixels_per_m;
    canvas.layer(0.25, |layer| disc(layer, goal, goal_radius, fill(GOAL)));
    canvas.layer(1.0, |layer| {
        let ring = stroke(layer, GOAL, 2.2);
        disc(layer, goal, goal_radius, ring);
        cross(layer, goal, 8.0, GOAL);
        disc(layer, start, VEHICLE.radius_m * view.pixels_per_m, fill(START));
        let heading = course.start_heading_rad();
        let (dx, dy) = (libm::sinf(heading), -libm::cosf(heading));
        let tip = [start[0] + 40.0 * dx, start[1] + 40.0 * dy];
        arrow(layer, start, tip, START);
    });
}

/// A line with a head at `tip`.
fn arrow(layer: &mut Layer, from: [f32; 2], tip: [f32; 2], colour: Rgb888) {
    let (length, half) = (12.0, 6.0);
    let (dx, dy) = (tip[0] - from[0], tip[1] - from[1]);
    let scale = 1.0 / libm::hypotf(dx, dy).max(1e-3);
    let (dx, dy) = (dx * scale, dy * scale);
    let behind = |back: f32, side: f32| [tip[0] - back * dx - side * dy, tip[1] - back * dy + side * dx];
    line(layer, [from, behind(length, 0.0)], colour, 3.0);
    polygon(layer, &[tip, behind(length, half), behind(length, -half)], colour);
}

fn path_colour(path: &FlightPath, index: usize) -> Rgb888 {
    match path.outcome {
        Some(Outcome::Success) => Rgb888::new(24, 118, 210),
        Some(Outcome::Collision) => Rgb888::new(206, 40, 48),
        Some(Outcome::OutOfBounds) => Rgb888::new(226, 118, 16),
        Some(Outcome::TimeOut) => Rgb888::new(142, 60, 180),
        None => UNKNOWN_PATHS[index % UNKNOWN_PATHS.len()],
    }
}

fn draw_path(layer: &mut Layer, view: &View, path: &FlightPath, colour: Rgb888) {
    let (width, height) = (view.width as f32, view.height as f32);
    let finite = path.points_ned_m.iter().filter(|p| p.is_finite());
    // A flight that left the picture runs along its rim.
    let points: Vec<[f32; 2]> = finite
        .map(|p| view.at(p.x, p.y))
        .map(|[x, y]| [x.clamp(0.0, width), y.clamp(0.0, height)])
        .collect();
    band(layer, &points, colour, 2.4);
    match (points.last(), path.outcome) {
        (None, _) => {}
        (Some(last), Some(Outcome::Success) | None) => disc(layer, *last, 4.5, fill(colour)),
        (Some(last), Some(_)) => cross(layer, *last, 7.0, colour),
    }
}

fn draw_labels(canvas: &mut Canvas, view: &View, course: &Course) {
    let mut label = |solid: &Solid, words: &str, colour: Rgb888, down: f32| {
        let c = solid.centre_ned_m();
        let [x, y] = view.at(c.x, c.y);
        text(canvas, words, [x, y + down], &FONT_6X10, colour, Alignment::Center);
    };
    for o in &course.boxes {
        let colour = if o.height_m > 0.55 * TALL_M { BACKGROUND } else { INK };
        label(&o.solid(), &format!("{:.1}", o.height_m), colour, 0.0);
    }
    for o in &course.overhangs {
        label(&o.solid(), &format!("{:.1}-{:.1}", o.bottom_m, o.top_m), INK, 0.0);
    }
    let [x, y] = view.at(course.goal.north_m, course.goal.east_m);
    let below = course.goal_radius_m * view.pixels_per_m + 10.0;
    text(canvas, "goal", [x, y - below], &FONT_8X13, GOAL, Alignment::Center);
    let [x, y] = view.at(course.start.north_m, course.start.east_m);
    text(canvas, "start", [x, y + 22.0], &FONT_8X13, START, Alignment::Center);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::{Family, generate};

    fn pixel(image: &Image, [x, y]: [f32; 2]) -> [u8; 3] {
        let at = 3 * (y.round() as usize * image.width() + x.round() as usize);
        [image.rgb()[at], image.rgb()[at + 1], image.rgb()[at + 2]]
    }

    /// A course with nothing but columns 10.3 m north, so far east and so high.
    fn with_columns(columns: &[(f32, f32)]) -> Course {
        let column = |(east_m, height_m): &(f32, f32)| {
            format!("[[column]]\nnorth_m = 10.3\neast_m = {east_m:?}\nradius_m = 0.5\nheight_m = {height_m:?}\n")
        };
        crate::testing::field(5.0, 12.0, &columns.iter().map(column).collect::<String>())
    }

    #[test]
    fn a_column_is_where_the_course_says_and_darker_the_taller() {
        let course = with_columns(&[(-6.3, 1.0), (6.3, 4.0)]);
        let image = draw(&course, &[]);
        let view = View::of(&course);
        let (low, tall) = (pixel(&image, view.at(10.3, -6.3)), pixel(&image, view.at(10.3, 6.3)));
        assert_eq!(tall, [TALL.r(), TALL.g(), TALL.b()]);
        assert!(low[0] > tall[0] + 60, "{low:?} {tall:?}");
        let beside = pixel(&image, view.at(10.3, -8.3));
        assert_eq!(beside, [BACKGROUND.r(), BACKGROUND.g(), BACKGROUND.b()]);
    }

    #[test]
    fn a_mover_is_drawn_with_its_way() {
        let course = |mover: &str| crate::testing::field(0.0, 8.0, mover);
        let with = course(
            "[[mover]]\nfrom_m = [10.0, -5.0]\nto_m = [10.0, 5.0]\nspeed_m_s = 0.5\nheight_m = 2.0\n\
             shape = { column = { radius_m = 0.4 } }",
        );
        let colour = [MOVER.r(), MOVER.g(), MOVER.b()];
        let pixels = |course: &Course| {
            let image = draw(course, &[]);
            image.rgb().chunks_exact(3).filter(|p| **p == colour).count()
        };
        assert_eq!(pixels(&course("")), 0);
        // A disc of 0.8 m at 32 pixels a metre has 515 pixels; the arrow, a little transparent, adds none of the same colour.
        assert!((300..900).contains(&pixels(&with)), "{}", pixels(&with));
    }

    #[test]
    fn the_vector_picture_has_the_shapes_of_the_raster() {
        let mut course = with_columns(&[(-6.3, 4.0)]);
        course.name = "one <column> & nothing else".to_owned();
        let svg = draw_svg(&course, &[]);
        let view = View::of(&course);
        let [x, y] = view.at(10.3, -6.3);
        let radius = 0.5 * view.pixels_per_m;
        let column = format!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" fill=\"{}\"",
            hex(TALL)
        );
        assert!(svg.contains(&column), "{column}");
        for part in [
            "one &lt;column&gt; &amp; nothing else",
            ">goal<",
            ">start<",
            "east of home, m",
            "</svg>",
        ] {
            assert!(svg.contains(part), "{part}");
        }
    }

    #[test]
    fn letters_beyond_ascii_in_a_courses_name_are_drawn() {
        let named = |name: &str| {
            let mut course = with_columns(&[]);
            course.name = name.to_owned();
            draw(&course, &[])
        };
        assert_ne!(named("Gebäude"), named("Geb?ude"));
    }

    #[test]
    fn a_flight_is_drawn_where_it_went_and_nonsense_in_it_is_left_out() {
        let course = generate(Family::Training, 0);
        let points = [(-2.0, -11.0), (f32::NAN, 0.0), (-2.0, -9.0), (900.0, -9.0)];
        let path = FlightPath {
            label: "flight".to_owned(),
            points_ned_m: points.iter().map(|(n, e)| NedVector::new(*n, *e, -1.5)).collect(),
            outcome: Some(Outcome::Collision),
        };
        let (with, without) = (draw(&course, core::slice::from_ref(&path)), draw(&course, &[]));
        let view = View::of(&course);
        let at = view.at(-2.0, -10.3);
        let seen = pixel(&with, at);
        assert!(seen[0] > 180 && seen[1] < 90, "{seen:?}");
        assert_ne!(seen, pixel(&without, at));
    }

    #[test]
    fn a_picture_that_cannot_be_written_names_the_file() {
        let image = Image::new(4, 4, BACKGROUND);
        let written = image.write_png(std::path::Path::new("no/such/folder/a.png"));
        let error = written.expect_err("no folder").to_string();
        let begin = "cannot write picture no/such/folder/a.png: ";
        assert!(error.starts_with(begin), "{error}");
    }
}
