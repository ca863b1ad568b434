//! The geofence: areas to stay in and areas to stay out of. <https://mavlink.io/en/services/mission.html#geofence-plan>

use crate::plan::{PlanDefect, PlanItem};
use vigil_mavlink::common::MavMissionResult;

const NAV_FENCE_POLYGON_VERTEX_INCLUSION: u16 = 5001;
const NAV_FENCE_POLYGON_VERTEX_EXCLUSION: u16 = 5002;
const NAV_FENCE_CIRCLE_INCLUSION: u16 = 5003;
const NAV_FENCE_CIRCLE_EXCLUSION: u16 = 5004;
const MAX_RADIUS_M: f32 = 20_000.0;
/// Area over length of the border below which a polygon holds nothing: its vertices are one place, or lie in a line but for
/// the centimetre to which they are rounded.
const MIN_WIDTH_M: f32 = 0.02;

#[derive(Debug, Clone, PartialEq)]
struct Area {
    is_inclusion: bool,
    /// Metres north and east of home: at least three, or a circle's centre.
    vertices_m: Vec<(f32, f32)>,
    /// Of a circle.
    radius_m: Option<f32>,
}

impl Area {
    fn contains(&self, (north, east): (f32, f32)) -> bool {
        let mut previous = self.vertices_m.last().copied().unwrap_or_default();
        if let Some(radius_m) = self.radius_m {
            return libm::hypotf(north - previous.0, east - previous.1) <= radius_m;
        }
        // Even-odd: a ray to the east crosses the border an odd number of times.
        let mut inside = false;
        for &vertex in &self.vertices_m {
            let ((n0, e0), (n1, e1)) = (previous, vertex);
            if (n0 > north) != (n1 > north) && east < e0 + (e1 - e0) * (north - n0) / (n1 - n0) {
                inside = !inside;
            }
            previous = vertex;
        }
        inside
    }
}

/// The area of a polygon over the length of its border, metres.
fn width_m(vertices: &[(f32, f32)]) -> f32 {
    let (mut twice_area_m2, mut border_m) = (0.0, 0.0);
    let origin = vertices.first().copied().unwrap_or_default();
    for (from, to) in vertices.iter().zip(vertices.iter().cycle().skip(1)) {
        let (north, east) = (to.0 - from.0, to.1 - from.1);
        twice_area_m2 += (from.0 - origin.0) * east - (from.1 - origin.1) * north;
        border_m += libm::hypotf(north, east);
    }
    if border_m > 0.0 {
        twice_area_m2.abs() / 2.0 / border_m
    } else {
        0.0
    }
}

/// What an item is of: whether a polygon, not a circle, and whether to stay in, not out.
fn form(item: &PlanItem) -> Option<(bool, bool)> {
    match item.command {
        NAV_FENCE_POLYGON_VERTEX_INCLUSION => Some((true, true)),
        NAV_FENCE_POLYGON_VERTEX_EXCLUSION => Some((true, false)),
        NAV_FENCE_CIRCLE_INCLUSION => Some((false, true)),
        NAV_FENCE_CIRCLE_EXCLUSION => Some((false, false)),
        _ => None,
    }
}

/// Whether an item is a circle of radius 0. It holds nothing, wherever it is: MAVSDK's example sends one off Africa, at 0° 0°.
pub(crate) fn is_empty_circle(item: &PlanItem) -> bool {
    matches!(form(item), Some((false, _))) && item.params[0] == 0.0
}

/// The geofence. Without areas everything is allowed.
#[derive(Debug, Default)]
pub(crate) struct Fence(Vec<Area>);

impl Fence {
    /// Whether an item by itself can be part of a geofence.
    pub fn check(item: &PlanItem) -> Result<(), PlanDefect> {
        let size = item.param(1).unwrap_or(0.0);
        let is_sound = match form(item) {
            Some((true, _)) => (3.0..=200.0).contains(&size) && size.fract() == 0.0,
            Some((false, _)) => (0.0..=MAX_RADIUS_M).contains(&item.params[0]),
            None => return Err(PlanDefect::unsupported("neither polygon nor circle")),
        };
        if !is_sound {
            return Err(PlanDefect::of_parameter(1, "radius or number of vertices"));
        }
        match is_empty_circle(item) {
            true => Ok(()),
            false => item.point().map(|_| ()),
        }
    }

    pub fn new(items: &[PlanItem]) -> Result<Self, PlanDefect> {
        let mut areas = Vec::new();
        let mut rest = items;
        while let [first, ..] = rest {
            Self::check(first)?;
            let size = first.param(1).unwrap_or(0.0);
            let (is_polygon, is_inclusion) = form(first).unwrap_or_default();
            let used = if is_polygon { size as usize } else { 1 };
            if !is_empty_circle(first) {
                let is_same = |item: &&PlanItem| item.command == first.command && item.params[0] == size;
                let same = rest.iter().take(used).take_while(is_same);
                let vertices_m = same.map(PlanItem::point).collect::<Result<Vec<_>, _>>()?;
                if vertices_m.len() < used {
                    return Err(PlanDefect::of_parameter(1, "polygon with too few vertices"));
                }
                if is_polygon && width_m(&vertices_m) < MIN_WIDTH_M {
                    let result = MavMissionResult::MAV_MISSION_INVALID;
                    return Err(PlanDefect::new(result, "polygon without an area"));
                }
                areas.push(Area {
                    is_inclusion,
                    vertices_m,
                    radius_m: (!is_polygon).then_some(size),
                });
            }
            rest = rest.get(used..).unwrap_or_default();
        }
        Ok(Self(areas))
    }

    /// Whether a place (metres north and east of home) is inside one of the areas to stay in, if there are any, and
    /// outside all areas to stay out of. Several areas to stay in are a union, as in PX4.
    pub fn allows(&self, place_m: (f32, f32)) -> bool {
        let mut inclusions = self.0.iter().filter(|a| a.is_inclusion).peekable();
        let included = inclusions.peek().is_none() || inclusions.any(|a| a.contains(place_m));
        let excluded = self.0.iter().any(|a| !a.is_inclusion && a.contains(place_m));
        included && !excluded
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::plans;

    fn item(command: u16, size: f32, place: (f32, f32)) -> PlanItem {
        plans::item(command, [size, 0.0, 0.0, 0.0], place, 0.0)
    }

    fn polygon(command: u16, vertices: &[(f32, f32)]) -> Vec<PlanItem> {
        let vertex = |v: &(f32, f32)| item(command, vertices.len() as f32, *v);
        vertices.iter().map(vertex).collect()
    }

    fn fence(items: Vec<PlanItem>) -> Fence {
        Fence::new(&items).expect("valid")
    }

    fn refused(items: Vec<PlanItem>) -> PlanDefect {
        Fence::new(&items).expect_err("refused")
    }

    /// An L: the corner at 10..20, 10..20 is missing.
    const L: [(f32, f32); 6] = [
        (0.0, 0.0),
        (20.0, 0.0),
        (20.0, 10.0),
        (10.0, 10.0),
        (10.0, 20.0),
        (0.0, 20.0),
    ];

    #[test]
    fn a_concave_polygon_contains_what_the_same_squares_contain() {
        let fence = fence(polygon(5001, &L));
        for i in -5..25 {
            for j in -5..25 {
                let (n, e) = (i as f32 + 0.5, j as f32 + 0.5);
                let in_squares = (0.0..20.0).contains(&n) && (0.0..20.0).contains(&e) && !(n > 10.0 && e > 10.0);
                assert_eq!(fence.allows((n, e)), in_squares, "{n} {e}");
            }
        }
    }

    #[test]
    fn areas_to_stay_in_are_a_union_and_areas_to_stay_out_of_win() {
        let mut items = polygon(5001, &L);
        items.push(item(5003, 5.0, (15.0, 15.0)));
        items.push(item(5004, 2.0, (5.0, 5.0)));
        let fence = fence(items);
        assert!(fence.allows((2.0, 2.0)) && fence.allows((15.0, 15.0)));
        assert!(!fence.allows((5.0, 6.0)) && !fence.allows((25.0, 25.0)));
    }

    #[test]
    fn without_an_area_to_stay_in_only_the_others_are_forbidden() {
        assert!(fence(Vec::new()).allows((1e4, 1e4)));
        let fence = fence(polygon(5002, &L));
        assert!(fence.allows((-1.0, -1.0)) && !fence.allows((1.0, 1.0)));
    }

    #[test]
    fn a_circle_of_radius_0_holds_nothing_and_forbids_nothing() {
        let alone = vec![item(5003, 0.0, (0.0, 5.0))];
        assert!(alone.iter().any(is_empty_circle) && fence(alone).allows((0.0, 0.0)));
        let mut items = polygon(5001, &L);
        let off_africa = PlanItem {
            x: 0,
            y: 0,
            ..item(5003, 0.0, (0.0, 0.0))
        };
        items.extend([off_africa, item(5003, 0.0, (50.0, 50.0)), item(5004, 0.0, (5.0, 5.0))]);
        let beside = fence(items);
        assert!(beside.allows((5.0, 5.0)) && !beside.allows((50.0, 50.0)));
        assert!(!polygon(5001, &L).iter().any(is_empty_circle));
    }

    #[test]
    fn a_polygon_without_an_area_is_refused_instead_of_forbidding_every_place() {
        for vertices in [
            [(0.0, 0.0); 3],
            [(0.0, 0.0), (20.0, 20.0), (40.0, 40.0)],
            [(0.0, -30.0), (0.0, 30.0), (0.0, -30.0)],
        ] {
            let defect = refused(polygon(5001, &vertices));
            assert_eq!(defect.reason, "polygon without an area", "{vertices:?}");
        }
        assert!(fence(polygon(5001, &[(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])).allows((0.2, 0.2)));
    }

    #[test]
    fn a_polygon_whose_vertices_do_not_add_up_is_refused() {
        let mut short = polygon(5001, &L);
        short.pop();
        let mut mixed = polygon(5001, &L);
        mixed[3].command = 5002;
        let mut two = polygon(5001, &L[..2]);
        two.extend(polygon(5002, &L));
        let circle = |radius_m: f32| vec![item(5003, radius_m, (0.0, 5.0))];
        for bad in [short, mixed, two, circle(-1.0), circle(f32::NAN)] {
            assert_eq!(refused(bad).result, MavMissionResult::MAV_MISSION_INVALID_PARAM1);
        }
        let waypoint = vec![item(16, 1.0, (0.0, 5.0))];
        assert_eq!(refused(waypoint).result, MavMissionResult::MAV_MISSION_UNSUPPORTED);
    }
}
