//! A course: what stands where, where to start, where to go, and what counts.

use crate::world::mesh::Mesh;
use crate::world::mover::Mover;
use crate::world::solid::{Solid, radians};
use crate::world::wire::Wire;
use serde::{Deserialize, Serialize};
use vigil_types::settings::{free, named_setting, required, section};
use vigil_types::{NedVector, named, settings};

settings! {
    /// A course. Everything is measured from the vehicle's home: north, east and height above ground in metres, angles in
    /// degrees clockwise from north. `docs/courses.md` describes the file.
    pub struct Course {
        /// Name for tables and pictures.
        pub name: String = required(),
        /// The generator's family; absent in a course made by hand.
        pub family: Option<Family> = free(None),
        /// The generator's seed; 0 in a course made by hand.
        pub seed: u64 = free(0),
        /// Height above ground to fly at.
        pub flight_height_m: f32 = free(1.5),
        /// A flight succeeds within this distance of the goal.
        pub goal_radius_m: f32 = free(1.0),
        /// A flight that takes longer has failed.
        pub time_limit_s: f32 = free(90.0),
        /// Height of a flat ceiling over everything, if there is one.
        pub ceiling_height_m: Option<f32> = free(None),
        /// Where the vehicle stands at first.
        pub start: Start = section(),
        /// Where to go.
        pub goal: GoalPoint = required(),
        /// What must not be left.
        pub bounds: Bounds = required(),
        /// Lines on the way that training rewards, in order.
        pub checkpoints: Vec<Checkpoint> = free(Vec::new()) => "checkpoint",
        /// Upright cylinders.
        pub columns: Vec<Column> = free(Vec::new()) => "column",
        /// Boxes on the ground.
        pub boxes: Vec<BoxObstacle> = free(Vec::new()) => "box",
        /// Walls.
        pub walls: Vec<Wall> = free(Vec::new()) => "wall",
        /// Boxes whose lower face is above the ground: beams, lintels, low roofs.
        pub overhangs: Vec<Overhang> = free(Vec::new()) => "overhang",
        /// Wires, cables, branches.
        pub wires: Vec<Wire> = free(Vec::new()) => "wire",
        /// Surfaces from files.
        pub meshes: Vec<Mesh> = free(Vec::new()) => "mesh",
        /// Columns and boxes that go to and fro.
        pub movers: Vec<Mover> = free(Vec::new()) => "mover",
    }

    /// The start: on the ground at home, with this heading.
    #[derive(Copy)]
    pub struct Start {
        /// North of home.
        pub north_m: f32 = free(0.0),
        /// East of home.
        pub east_m: f32 = free(0.0),
        /// Heading, clockwise from north.
        pub heading_deg: f32 = free(0.0),
    }

    /// The goal's place; its height is the flight height.
    #[derive(Copy)]
    pub struct GoalPoint {
        /// North of home.
        pub north_m: f32 = required(),
        /// East of home.
        pub east_m: f32 = required(),
    }

    /// A box in which the flight must stay, each as `[lowest, highest]`.
    #[derive(Copy)]
    pub struct Bounds {
        /// North of home.
        pub north_m: [f32; 2] = required(),
        /// East of home.
        pub east_m: [f32; 2] = required(),
        /// Height above which the flight is out of bounds.
        pub top_m: f32 = required(),
    }

    /// A line across the way; it is passed where the vehicle gets beyond it, anywhere along it.
    #[derive(Copy)]
    pub struct Checkpoint {
        /// A point of the line, north of home.
        pub north_m: f32 = required(),
        /// A point of the line, east of home.
        pub east_m: f32 = required(),
        /// The direction in which the line is passed, square to it.
        pub heading_deg: f32 = required(),
    }

    /// An upright cylinder on the ground.
    #[derive(Copy)]
    pub struct Column {
        /// North of home.
        pub north_m: f32 = required(),
        /// East of home.
        pub east_m: f32 = required(),
        /// Radius.
        pub radius_m: f32 = required(),
        /// Height.
        pub height_m: f32 = required(),
    }

    /// A box on the ground.
    #[derive(Copy)]
    pub struct BoxObstacle {
        /// Centre, north of home.
        pub north_m: f32 = required(),
        /// Centre, east of home.
        pub east_m: f32 = required(),
        /// Size along the box's own heading.
        pub length_m: f32 = required(),
        /// Size across it.
        pub width_m: f32 = required(),
        /// Height.
        pub height_m: f32 = required(),
        /// Heading of the length axis.
        pub yaw_deg: f32 = free(0.0),
    }

    /// A wall between two points.
    #[derive(Copy)]
    pub struct Wall {
        /// One end, `[north, east]`.
        pub from_m: [f32; 2] = required(),
        /// Other end, `[north, east]`.
        pub to_m: [f32; 2] = required(),
        /// Thickness.
        pub thickness_m: f32 = required(),
        /// Height.
        pub height_m: f32 = required(),
    }

    /// A box above the ground.
    #[derive(Copy)]
    pub struct Overhang {
        /// Centre, north of home.
        pub north_m: f32 = required(),
        /// Centre, east of home.
        pub east_m: f32 = required(),
        /// Size along the overhang's own heading.
        pub length_m: f32 = required(),
        /// Size across it.
        pub width_m: f32 = required(),
        /// Height of the lower face above ground.
        pub bottom_m: f32 = required(),
        /// Height of the upper face above ground.
        pub top_m: f32 = required(),
        /// Heading of the length axis.
        pub yaw_deg: f32 = free(0.0),
    }
}

named! {
    /// Families of generated courses.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Family {
        /// What policies are trained on.
        Training => "training",
        /// Other layouts and densities, for validation.
        Validation => "validation",
        /// Doors, pockets, gaps near 2 m and moving obstacles: where pilots fail.
        Hard => "hard",
        /// Validation's layouts filled up, with gaps from 1.8 m.
        Dense => "dense",
        /// Trees with branches from 1 cm thick.
        Forest => "forest",
    }
}

named_setting!(Family);

impl core::str::FromStr for Family {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let names = || Self::ALL.map(Self::name).join(", ");
        Self::from_name(name).ok_or_else(|| format!("no course family is called `{name}`; there are: {}", names()))
    }
}

impl core::fmt::Display for Family {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.name())
    }
}

impl Bounds {
    /// Whether a point is inside. There is no lower bound: the ground is one.
    pub fn contains(&self, p: NedVector) -> bool {
        self.contains_plan(p.x, p.y) && -p.z <= self.top_m
    }

    /// Whether a point is inside in the plan view.
    pub fn contains_plan(&self, north_m: f32, east_m: f32) -> bool {
        (self.north_m[0]..=self.north_m[1]).contains(&north_m) && (self.east_m[0]..=self.east_m[1]).contains(&east_m)
    }
}

impl Column {
    /// Its geometry.
    pub fn solid(&self) -> Solid {
        Solid::cylinder((self.north_m, self.east_m), self.radius_m, self.height_m)
    }
}

impl BoxObstacle {
    /// Its geometry.
    pub fn solid(&self) -> Solid {
        Solid::cuboid(
            (self.north_m, self.east_m),
            [self.length_m, self.width_m],
            [0.0, self.height_m],
            radians(self.yaw_deg),
        )
    }
}

impl Wall {
    /// Its geometry: a box whose length runs from end to end.
    pub fn solid(&self) -> Solid {
        Solid::along(self.from_m, self.to_m, 0.0, self.thickness_m, self.height_m)
    }
}

impl Overhang {
    /// Its geometry.
    pub fn solid(&self) -> Solid {
        Solid::cuboid(
            (self.north_m, self.east_m),
            [self.length_m, self.width_m],
            [self.bottom_m, self.top_m],
            radians(self.yaw_deg),
        )
    }
}

impl Course {
    /// All obstacles that stand still as geometry, in the order columns, boxes, walls, overhangs. Ground and ceiling are not
    /// among them; movers are in [`Course::movers`], surfaces in [`Course::meshes`] and [`Course::wires`].
    pub fn solids(&self) -> Vec<Solid> {
        let columns = self.columns.iter().map(Column::solid);
        let boxes = self.boxes.iter().map(BoxObstacle::solid);
        let walls = self.walls.iter().map(Wall::solid);
        let overhangs = self.overhangs.iter().map(Overhang::solid);
        columns.chain(boxes).chain(walls).chain(overhangs).collect()
    }

    /// Takes all obstacles away, those that move as well.
    pub fn clear_obstacles(&mut self) {
        self.columns.clear();
        self.boxes.clear();
        self.walls.clear();
        self.overhangs.clear();
        self.wires.clear();
        self.meshes.clear();
        self.movers.clear();
    }

    /// The start on the ground.
    pub fn start_ned_m(&self) -> NedVector {
        NedVector::new(self.start.north_m, self.start.east_m, 0.0)
    }

    /// Heading at the start, clockwise from north.
    pub fn start_heading_rad(&self) -> f32 {
        radians(self.start.heading_deg)
    }

    /// The goal at flight height.
    pub fn goal_ned_m(&self) -> NedVector {
        NedVector::new(self.goal.north_m, self.goal.east_m, -self.flight_height_m)
    }
}
