//! What a camera behind the vehicle sees: obstacles, ground, goal, the vehicle and its path, in few flat shades, which keep a film small.

use super::picture::{Canvas, Colour};
use vigil_log::SceneSolid;
use vigil_types::{Attitude, FrdVector, NedVector};

/// How far behind the vehicle and above it the camera stands, metres, and how far ahead of it it looks.
const BEHIND_M: f32 = 3.2;
const ABOVE_M: f32 = 1.2;
const AHEAD_M: f32 = 3.0;
/// A wall comes no nearer to the camera than this.
const WALL_M: f32 = 0.2;
/// Tangent of half of the horizontal field of view.
const HALF_VIEW: f32 = 0.8;
/// Nothing is drawn further away, metres.
const FURTHEST_M: f32 = 60.0;
/// The share of a turn that the camera makes up in a picture.
const FOLLOW: f32 = 0.35;
/// Half of the vehicle's width between its rotors' axes, and a rotor's radius, metres.
const ARM_M: f32 = 0.21;
const ROTOR_M: f32 = 0.15;

type Vec3 = [f32; 3];

fn minus(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: Vec3, b: Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(a: Vec3) -> Vec3 {
    let length = dot(a, a).sqrt().max(f32::MIN_POSITIVE);
    a.map(|v| v / length)
}

/// A box or an upright cylinder.
struct Block {
    centre: Vec3,
    half: Vec3,
    yaw: (f32, f32),
    is_round: bool,
    is_goal: bool,
}

impl Block {
    fn of(solid: &SceneSolid) -> Self {
        let (centre, half, yaw_rad) = solid.parts();
        Self {
            centre,
            half,
            yaw: f32::sin_cos(yaw_rad),
            is_round: matches!(solid, SceneSolid::Cylinder { .. }),
            is_goal: false,
        }
    }

    /// Into its own axes.
    fn turned(&self, v: Vec3) -> Vec3 {
        let (sin, cos) = self.yaw;
        [cos * v[0] + sin * v[1], cos * v[1] - sin * v[0], v[2]]
    }

    /// Where a ray comes in from outside, and the shade there; what the eye stands in is not seen.
    fn hit(&self, eye: Vec3, ray: Vec3) -> Option<(f32, u8)> {
        let (from, along) = (self.turned(minus(eye, self.centre)), self.turned(ray));
        let (mut enter, mut leave, mut shade) = (f32::NEG_INFINITY, f32::INFINITY, Colour::SOLID);
        let mut face = |near: f32, far: f32, of: u8| {
            if near > enter {
                (enter, shade) = (near, of);
            }
            leave = leave.min(far);
        };
        let slab = |axis: usize| {
            let speed = if along[axis].abs() < 1e-9 { 1e-9 } else { along[axis] };
            let (half, from) = (self.half[axis], from[axis]);
            let (a, b) = ((-half - from) / speed, (half - from) / speed);
            (a.min(b), a.max(b))
        };
        let (low, high) = slab(2);
        face(low, high, Colour::SOLID_TOP);
        if self.is_round {
            let a = (along[0] * along[0] + along[1] * along[1]).max(1e-12);
            let b = from[0] * along[0] + from[1] * along[1];
            let c = from[0] * from[0] + from[1] * from[1] - self.half[0] * self.half[0];
            let root = (b * b - a * c).sqrt();
            // No root, no contact: the comparison below fails with what is no number.
            let near = (-b - root) / a;
            let across = (from[1] + near * along[1]) / self.half[0];
            let is_dark = across > 0.3;
            if root.is_nan() {
                return None;
            }
            let of = if is_dark { Colour::SOLID_DARK } else { Colour::SOLID };
            face(near, (-b + root) / a, of);
        } else {
            for (axis, of) in [(0, Colour::SOLID), (1, Colour::SOLID_DARK)] {
                let (near, far) = slab(axis);
                face(near, far, of);
            }
        }
        let shade = if self.is_goal { Colour::GOAL } else { shade };
        (enter > 0.0 && enter <= leave).then_some((enter, shade))
    }
}

/// The course as the camera sees it.
pub struct Stage {
    blocks: Vec<Block>,
    /// Where the camera looks, radians from north; follows the vehicle.
    heading_rad: Option<f32>,
}

/// The vehicle at a moment.
pub struct Seen<'a> {
    pub position_ned_m: NedVector,
    pub attitude: Attitude,
    /// Where it was, with the colour of who flew.
    pub trail: &'a [(NedVector, u8)],
    pub colour: u8,
}

impl Stage {
    /// Obstacles, and the goal as a thin post.
    pub fn new(solids: &[SceneSolid], goal_ned_m: Option<NedVector>) -> Self {
        let mut blocks: Vec<Block> = solids.iter().map(Block::of).collect();
        blocks.extend(goal_ned_m.filter(|g| g.is_finite()).map(|goal| Block {
            centre: [goal.x, goal.y, 0.5 * goal.z - 0.75],
            half: [0.12, 0.12, 0.5 * goal.z.abs() + 0.75],
            yaw: (0.0, 1.0),
            is_round: true,
            is_goal: true,
        }));
        Self {
            blocks,
            heading_rad: None,
        }
    }

    /// Draws the view into a part of the picture: left, top, width, height.
    pub fn draw(&mut self, canvas: &mut Canvas, place: [usize; 4], seen: &Seen<'_>) {
        let yaw_rad = seen.attitude.yaw_rad();
        let before = self.heading_rad.unwrap_or(yaw_rad);
        let heading_rad = before + FOLLOW * vigil_types::wrap_pi(yaw_rad - before);
        self.heading_rad = Some(heading_rad);
        let camera = self.camera(seen.position_ned_m, heading_rad, place);

        let [left, top, width, height] = place;
        // Most obstacles are far away or behind.
        let is_near = |block: &&Block| {
            let reach = block.half[0].hypot(block.half[1]) + block.half[2];
            let to = minus(block.centre, camera.eye);
            dot(to, camera.ahead) > -reach && dot(to, to).sqrt() - reach < FURTHEST_M
        };
        let near: Vec<&Block> = self.blocks.iter().filter(is_near).collect();
        let mut ranges = vec![f32::INFINITY; width * height];
        for y in 0..height {
            for x in 0..width {
                let ray = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
                let mut nearest = (f32::INFINITY, Colour::BANNER);
                if ray[2] > 0.0 {
                    let t = -camera.eye[2] / ray[2];
                    let square = |axis: usize| (camera.eye[axis] + t * ray[axis]).div_euclid(2.0) as i32;
                    let is_odd = t > 0.0 && t < FURTHEST_M && (square(0) + square(1)).rem_euclid(2) != 0;
                    nearest = (t, if is_odd { Colour::GROUND } else { Colour::PAPER });
                }
                for block in &near {
                    if let Some((t, shade)) = block.hit(camera.eye, ray)
                        && t < nearest.0
                    {
                        nearest = (t, shade);
                    }
                }
                ranges[y * width + x] = nearest.0;
                canvas.rectangle(left + x, top + y, 1, 1, nearest.1);
            }
        }

        let on_canvas = |point: Vec3| {
            let (x, y, distance) = camera.project(point)?;
            let inside = x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32;
            // The ray's parameter is the distance along a unit vector.
            let is_seen = inside && ranges[y as usize * width + x as usize] > distance - 0.3;
            is_seen.then_some((left as f32 + x, top as f32 + y))
        };
        let place = |(p, colour): &(NedVector, u8)| (on_canvas([p.x, p.y, p.z]), *colour);
        let points: Vec<_> = seen.trail.iter().map(place).collect();
        for pair in points.windows(2) {
            if let (Some(a), Some(b)) = (pair[0].0, pair[1].0) {
                canvas.line(a, b, 3.0, pair[1].1);
            }
        }
        vehicle(canvas, &camera, (left, top), seen);
    }

    fn camera(&self, at: NedVector, heading_rad: f32, [_, _, width, height]: [usize; 4]) -> Camera {
        let (sin, cos) = heading_rad.sin_cos();
        let at = [at.x, at.y, at.z];
        let back = [-BEHIND_M * cos, -BEHIND_M * sin, -ABOVE_M];
        let (length, way) = (dot(back, back).sqrt(), unit(back));
        let free = self.blocks.iter().filter(|block| !block.is_goal);
        let wall = free.filter_map(|block| block.hit(at, way)).map(|(t, _)| t - WALL_M);
        let stands = wall.fold(length, f32::min).max(0.8);
        let eye = [0, 1, 2].map(|k| at[k] + stands * way[k]);
        let ahead = unit(minus([at[0] + AHEAD_M * cos, at[1] + AHEAD_M * sin, at[2]], eye));
        let right = [-sin, cos, 0.0];
        let down = [
            ahead[1] * right[2] - ahead[2] * right[1],
            ahead[2] * right[0] - ahead[0] * right[2],
            ahead[0] * right[1] - ahead[1] * right[0],
        ];
        Camera {
            eye,
            ahead,
            right,
            down,
            middle: (0.5 * width as f32, 0.5 * height as f32),
            focal: 0.5 * width as f32 / HALF_VIEW,
        }
    }
}

struct Camera {
    eye: Vec3,
    ahead: Vec3,
    right: Vec3,
    down: Vec3,
    middle: (f32, f32),
    /// Pixels.
    focal: f32,
}

impl Camera {
    /// The unit vector of a pixel.
    fn ray(&self, x: f32, y: f32) -> Vec3 {
        let (u, v) = ((x - self.middle.0) / self.focal, (y - self.middle.1) / self.focal);
        unit([0, 1, 2].map(|k| self.ahead[k] + u * self.right[k] + v * self.down[k]))
    }

    /// Pixel and distance of a point before the camera.
    fn project(&self, point: Vec3) -> Option<(f32, f32, f32)> {
        let to = minus(point, self.eye);
        let depth = dot(to, self.ahead);
        (depth > 0.2).then(|| {
            let scale = self.focal / depth;
            (
                self.middle.0 + scale * dot(to, self.right),
                self.middle.1 + scale * dot(to, self.down),
                dot(to, to).sqrt(),
            )
        })
    }
}

/// Four rotors on two arms, and a nose in the colour of who flies.
fn vehicle(canvas: &mut Canvas, camera: &Camera, (left, top): (usize, usize), seen: &Seen<'_>) {
    let at = |forward: f32, right: f32| {
        let p = seen.attitude.to_ned(FrdVector::new(forward, right, 0.0));
        let q = seen.position_ned_m;
        let (x, y, _) = camera.project([q.x + p.x, q.y + p.y, q.z + p.z])?;
        Some((left as f32 + x, top as f32 + y))
    };
    for (a, b) in [((ARM_M, ARM_M), (-ARM_M, -ARM_M)), ((ARM_M, -ARM_M), (-ARM_M, ARM_M))] {
        if let (Some(a), Some(b)) = (at(a.0, a.1), at(b.0, b.1)) {
            canvas.line(a, b, 4.0, Colour::INK);
        }
    }
    for (forward, right) in [(ARM_M, ARM_M), (ARM_M, -ARM_M), (-ARM_M, ARM_M), (-ARM_M, -ARM_M)] {
        let rim: Option<Vec<_>> = (0..14_u8)
            .map(|i| (f32::from(i) * std::f32::consts::TAU / 14.0).sin_cos())
            .map(|(sin, cos)| at(forward + ROTOR_M * cos, right + ROTOR_M * sin))
            .collect();
        if let Some(rim) = rim {
            canvas.polygon(&rim, Colour::INK);
        }
    }
    if let (Some(a), Some(b)) = (at(0.0, 0.0), at(1.6 * ARM_M, 0.0)) {
        canvas.line(a, b, 5.0, seen.colour);
        canvas.disc(a, 5.0, seen.colour);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLACE: [usize; 4] = [0, 0, 120, 80];

    fn view(solids: &[SceneSolid], goal: Option<NedVector>) -> Canvas {
        let mut canvas = Canvas::new(120, 80, Colour::INK);
        let seen = Seen {
            position_ned_m: NedVector::new(0.0, 0.0, -1.5),
            attitude: Attitude::LEVEL_NORTH,
            trail: &[],
            colour: Colour::RECOVERY,
        };
        Stage::new(solids, goal).draw(&mut canvas, PLACE, &seen);
        canvas
    }

    fn count(canvas: &Canvas, colours: &[u8], columns: std::ops::Range<usize>) -> usize {
        let is_one = |i: &usize| columns.contains(&(i % 120)) && colours.contains(&canvas.pixels[*i]);
        (0..120 * 80).filter(is_one).count()
    }

    #[test]
    fn an_obstacle_stands_where_it_is_and_hides_what_is_behind_it() {
        let solid = [Colour::SOLID, Colour::SOLID_DARK, Colour::SOLID_TOP];
        let right = SceneSolid::Cylinder {
            centre_ned_m: [6.0, 3.0, -1.5],
            radius_m: 0.5,
            half_height_m: 1.5,
        };
        let canvas = view(&[right], None);
        assert!(count(&canvas, &solid, 70..120) > 50);
        assert_eq!(count(&canvas, &solid, 0..60), 0);
        assert!(count(&canvas, &[Colour::RECOVERY], 40..80) > 5, "the vehicle's nose");

        let goal = Some(NedVector::new(12.0, 0.0, -1.5));
        assert!(count(&view(&[], goal), &[Colour::GOAL], 50..70) > 10);
        let wall = SceneSolid::Cuboid {
            centre_ned_m: [8.0, 0.0, -3.0],
            half_extents_m: [0.1, 6.0, 3.0],
            yaw_rad: 0.0,
        };
        assert_eq!(count(&view(&[wall], goal), &[Colour::GOAL], 0..120), 0);
    }

    #[test]
    fn a_wall_at_the_vehicles_back_does_not_stand_before_the_camera() {
        let wall = SceneSolid::Cuboid {
            centre_ned_m: [-1.5, 0.0, -3.0],
            half_extents_m: [0.1, 6.0, 3.0],
            yaw_rad: 0.0,
        };
        let canvas = view(&[wall], None);
        assert!(count(&canvas, &[Colour::INK], 0..120) > 200, "the vehicle is seen");
    }
}
