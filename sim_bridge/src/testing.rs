//! Courses that this crate's unit tests share.

use crate::world::Course;

/// A field with a goal 20 m north and so far east, within so many metres to either side, and what the text puts into it.
pub(crate) fn field(goal_east_m: f32, half_width_m: f32, text: &str) -> Course {
    let text = format!(
        "name = \"test\"\ngoal = {{ north_m = 20.0, east_m = {goal_east_m:?} }}\n\
         bounds = {{ north_m = [-4.0, 26.0], east_m = [{:?}, {half_width_m:?}], top_m = 6.0 }}\n{text}",
        -half_width_m
    );
    Course::from_toml_str(&text, "test").expect("valid")
}
