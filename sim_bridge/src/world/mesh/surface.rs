//! Triangles in a tree of boxes. Sixteen boxes or triangles are looked at together: that many are one vector.

use glamx::{Pose3, Vec3};
use parry3d::bounding_volume::{Aabb, BoundingVolume};
use parry3d::query::{PointQuery, intersection_test};
use parry3d::shape::Shape;
use std::collections::HashMap;
use vigil_types::NedVector;

/// Boxes of a node, and triangles of a leaf.
pub(crate) const LANES: usize = 16;
/// Boxes are this much larger than what they hold, so that rounding can never hide a triangle.
const MARGIN_M: f32 = 1e-3;
/// From this depth on the triangles are halved, whatever that costs: it bounds the depth.
const FREE_DEPTH: usize = 8;
/// Nodes that wait on the way down: 15 a level, of eight levels and of what halving needs for the most triangles: a node's largest part is an
/// eighth.
const WAITING: usize = (FREE_DEPTH + 6) * LANES;

/// Corners, NED metres.
pub(crate) type Triangle = [[f32; 3]; 3];

/// A triangle mesh as a surface, NED metres from home.
#[derive(PartialEq)]
pub(crate) struct Surface {
    nodes: Vec<Boxes>,
    blocks: Vec<Block>,
    pub(crate) open_edges: usize,
}

impl core::fmt::Debug for Surface {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Surface of {} triangles", self.triangles().count())
    }
}

/// A node: boxes, and what is in them.
#[derive(Clone, PartialEq, Default)]
pub(crate) struct Boxes {
    /// By axis.
    pub(crate) centre_m: [[f32; LANES]; 3],
    pub(crate) half_m: [[f32; LANES]; 3],
    pub(crate) child: [Child; LANES],
    pub(crate) count: usize,
}

/// A leaf: triangles by corner and axis.
#[derive(Clone, PartialEq)]
pub(crate) struct Block {
    pub(crate) corners: [[[f32; LANES]; 3]; 3],
    pub(crate) count: usize,
}

/// The number of a node or of a leaf.
#[derive(Clone, Copy, PartialEq, Default)]
pub(crate) struct Child(u32);

pub(crate) const ROOT: Child = Child(0);

/// What a [`Child`] is.
pub(crate) enum Within<'a> {
    Node(&'a Boxes),
    Leaf(&'a Block),
}

fn box_of(triangles: &[Triangle]) -> Aabb {
    Aabb::from_points(triangles.iter().flatten().map(|p| Vec3::from(*p)))
}

/// Half of a box's surface.
fn area_m2(of: &Aabb) -> f32 {
    let [x, y, z] = (of.maxs - of.mins).to_array();
    x * y + y * z + z * x
}

/// Three times the middle.
fn middle(t: &Triangle) -> [f32; 3] {
    core::array::from_fn(|k| t[0][k] + t[1][k] + t[2][k])
}

/// Puts the triangles into two parts and says where the second begins: by the area heuristic (MacDonald and Booth 1990) over 32 bins of
/// the longest axis, or into halves.
fn split(triangles: &mut [Triangle], depth: usize) -> usize {
    const BINS: usize = 32;
    let all = Aabb::from_points(triangles.iter().map(|t| Vec3::from(middle(t))));
    let wide = |k: &usize| all.maxs[*k] - all.mins[*k];
    let axis = (0..3).max_by(|a, b| wide(a).total_cmp(&wide(b))).unwrap_or(0);
    let half = triangles.len() / 2;
    if depth >= FREE_DEPTH || wide(&axis) <= 0.0 {
        triangles.select_nth_unstable_by(half, |a, b| middle(a)[axis].total_cmp(&middle(b)[axis]));
        return half;
    }
    let scale = BINS as f32 / wide(&axis);
    let bin = |t: &Triangle| (((middle(t)[axis] - all.mins[axis]) * scale) as usize).min(BINS - 1);
    let mut bins = [(0, Aabb::new_invalid()); BINS];
    for t in triangles.iter() {
        let (count, extent) = &mut bins[bin(t)];
        *count += 1;
        extent.merge(&box_of(core::slice::from_ref(t)));
    }
    let join = |(n, a): (usize, Aabb), (m, b): &(usize, Aabb)| (n + m, a.merged(b));
    let cost = |(count, extent): (usize, Aabb)| match count {
        0 => f32::INFINITY,
        _ => area_m2(&extent) * count.div_ceil(LANES) as f32,
    };
    let cut = |at: usize| {
        let none = (0, Aabb::new_invalid());
        cost(bins[..at].iter().fold(none, join)) + cost(bins[at..].iter().fold(none, join))
    };
    let best = (1..BINS).map(|at| (cut(at), at)).min_by(|a, b| a.0.total_cmp(&b.0));
    let best = best.map_or(1, |(_, at)| at);
    let mut first = 0;
    for i in 0..triangles.len() {
        if bin(&triangles[i]) < best {
            triangles.swap(i, first);
            first += 1;
        }
    }
    first
}

impl Surface {
    /// Of triangles, at least one, all of them finite.
    pub(crate) fn new(mut triangles: Vec<Triangle>, open_edges: usize) -> Self {
        let mut surface = Self {
            nodes: Vec::new(),
            blocks: Vec::new(),
            open_edges,
        };
        surface.add(&mut triangles, 0);
        surface
    }

    /// Adds a node of these triangles: the largest of its parts is split until there are enough.
    fn add(&mut self, triangles: &mut [Triangle], depth: usize) -> usize {
        let mut parts = vec![triangles];
        while parts.len() < LANES {
            let large = parts.iter().enumerate().filter(|(_, part)| part.len() > LANES);
            let size = |part: &[Triangle]| match depth < FREE_DEPTH {
                true => area_m2(&box_of(part)),
                false => part.len() as f32,
            };
            let Some((largest, _)) = large.max_by(|a, b| size(a.1).total_cmp(&size(b.1))) else {
                break;
            };
            let part = parts.swap_remove(largest);
            let at = split(part, depth);
            let (left, right) = part.split_at_mut(at);
            parts.extend([left, right]);
        }
        let number = self.nodes.len();
        self.nodes.push(Boxes {
            count: parts.len(),
            ..Boxes::default()
        });
        for (lane, part) in parts.into_iter().enumerate() {
            let extent = box_of(part);
            let child = match part.len() > LANES {
                true => Child((self.add(part, depth + 1) as u32) << 1),
                false => Child((self.add_block(part) as u32) << 1 | 1),
            };
            let node = &mut self.nodes[number];
            node.child[lane] = child;
            for k in 0..3 {
                node.centre_m[k][lane] = 0.5 * (extent.mins[k] + extent.maxs[k]);
                node.half_m[k][lane] = 0.5 * (extent.maxs[k] - extent.mins[k]) + MARGIN_M;
            }
        }
        number
    }

    fn add_block(&mut self, part: &[Triangle]) -> usize {
        let mut corners = [[[0.0; LANES]; 3]; 3];
        for (lane, triangle) in part.iter().enumerate() {
            for (corner, k) in (0..3).flat_map(|corner| (0..3).map(move |k| (corner, k))) {
                corners[corner][k][lane] = triangle[corner][k];
            }
        }
        let count = part.len();
        self.blocks.push(Block { corners, count });
        self.blocks.len() - 1
    }

    #[inline(always)]
    pub(crate) fn within(&self, child: Child) -> Within<'_> {
        let number = (child.0 >> 1) as usize;
        match child.0 & 1 {
            0 => Within::Node(&self.nodes[number]),
            _ => Within::Leaf(&self.blocks[number]),
        }
    }

    pub(crate) fn triangles(&self) -> impl Iterator<Item = Triangle> {
        self.blocks.iter().flat_map(Block::triangles)
    }

    /// Lowest and highest coordinates.
    pub(crate) fn extent_ned_m(&self) -> ([f32; 3], [f32; 3]) {
        let points = self.triangles().flatten().map(Vec3::from);
        let all = Aabb::from_points(points);
        (all.mins.to_array(), all.maxs.to_array())
    }

    /// Goes through the leaves whose boxes' keys (`key` of a node, by lane) are below a limit, the lowest of a node first; `leaf` looks at one and
    /// returns the limit from there on, which this returns in the end.
    #[inline(always)]
    pub(crate) fn search(
        &self,
        mut limit: f32,
        key: impl Fn(&Boxes) -> [f32; LANES],
        mut leaf: impl FnMut(&Block, f32) -> f32,
    ) -> f32 {
        let mut waiting = [(f32::NEG_INFINITY, ROOT); WAITING];
        let mut count = 1;
        while count > 0 {
            count -= 1;
            let (nearest, child) = waiting[count];
            if nearest >= limit {
                continue;
            }
            match self.within(child) {
                Within::Leaf(block) => limit = leaf(block, limit),
                Within::Node(boxes) => {
                    let (keys, first) = (key(boxes), count);
                    for lane in (0..boxes.count).filter(|lane| keys[*lane] < limit) {
                        let mut at = count;
                        while at > first && waiting[at - 1].0 < keys[lane] {
                            waiting[at] = waiting[at - 1];
                            at -= 1;
                        }
                        waiting[at] = (keys[lane], boxes.child[lane]);
                        count += 1;
                    }
                }
            }
        }
        limit
    }

    /// Distance from a point, metres.
    pub(crate) fn distance_m(&self, point_ned_m: NedVector) -> f32 {
        let p = point_ned_m.to_array();
        let to_boxes = |boxes: &Boxes| {
            let mut square = [0.0; LANES];
            for (k, p) in p.iter().enumerate() {
                for (lane, square) in square.iter_mut().enumerate() {
                    let beside = ((boxes.centre_m[k][lane] - p).abs() - boxes.half_m[k][lane]).max(0.0);
                    *square += beside * beside;
                }
            }
            square.map(f32::sqrt)
        };
        self.search(f32::INFINITY, to_boxes, |block, limit| {
            let distances = block.shapes().map(|t| t.distance_to_local_point(Vec3::from(p), true));
            distances.fold(limit, f32::min)
        })
    }

    /// Whether a shape touches it whose box this is. Exact within a centimetre.
    pub(crate) fn touches(&self, pose: &Pose3, shape: &dyn Shape, reach: &Aabb) -> bool {
        let (centre, half) = (reach.center(), reach.half_extents());
        let apart = |boxes: &Boxes| {
            core::array::from_fn(|lane| {
                let apart = |k: usize| (boxes.centre_m[k][lane] - centre[k]).abs() > boxes.half_m[k][lane] + half[k];
                if apart(0) || apart(1) || apart(2) {
                    f32::INFINITY
                } else {
                    0.0
                }
            })
        };
        // Below every key as soon as one is touched.
        let limit = self.search(1.0, apart, |block, limit| {
            let mut near = block.shapes().filter(|t| t.local_aabb().intersects(reach));
            // Every pair of triangle and convex shape is supported; were one not, calling it touched is the safe answer.
            let touched = near
                .any(|t| intersection_test(pose, shape, &Pose3::IDENTITY, &t).map_or(true, |found| found.intersecting));
            if touched { -1.0 } else { limit }
        });
        limit < 0.0
    }
}

impl Block {
    pub(crate) fn triangle(&self, lane: usize) -> Triangle {
        self.corners.map(|corner| corner.map(|axis| axis[lane]))
    }

    fn triangles(&self) -> impl Iterator<Item = Triangle> {
        (0..self.count).map(|lane| self.triangle(lane))
    }

    fn shapes(&self) -> impl Iterator<Item = parry3d::shape::Triangle> {
        let shape = |[a, b, c]: [[f32; 3]; 3]| parry3d::shape::Triangle::new(a.into(), b.into(), c.into());
        self.triangles().map(shape)
    }
}

/// Whether a triangle has an area at all.
pub(super) fn has_area(t: &Triangle) -> bool {
    let [u, v] = [1, 2].map(|to| core::array::from_fn::<f32, 3, _>(|k| t[to][k] - t[0][k]));
    (0..3).any(|k| u[k] * v[(k + 1) % 3] != u[(k + 1) % 3] * v[k])
}

/// How many edges belong to one triangle alone; corners are the same where their coordinates are.
pub(super) fn open_edges(triangles: &[Triangle]) -> usize {
    let mut numbers = HashMap::new();
    let mut edges = Vec::with_capacity(3 * triangles.len());
    for t in triangles {
        let [a, b, c] = t.map(|p| {
            let next = numbers.len() as u32;
            *numbers.entry(p.map(f32::to_bits)).or_insert(next)
        });
        // Two corners at one place: a line, which is no part of the surface.
        if a != b && b != c && c != a {
            edges.extend([(a, b), (b, c), (c, a)].map(|(a, b)| (a.min(b), a.max(b))));
        }
    }
    edges.sort_unstable();
    edges.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).count()
}
