//! The recovery pilot in small worlds drawn by hand, seen through frames that somebody has altered.

mod common;

use common::{Scene, block, column, fly};
use vigil_policy::{Pilot, PilotInput, RecoveryPilot};
use vigil_types::{Action, DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_ROWS, DepthFrame};

/// Alters frames as an attack on the actor by accumulating BIM does (ε = 1/255, 20 iterations; measured on the trained
/// actor): pixels move by up to 7.8 m to either side, σ 3.2 m, neighbours by a common part that changes slowly.
struct Altered {
    pilot: Box<RecoveryPilot>,
    frame: Box<DepthFrame>,
    blocks: Vec<f32>,
    state: u64,
}

const BLOCK: usize = 8;
const COMMON_M: f32 = 1.4;
const OWN_M: f32 = 2.8;
const LIMIT_M: f32 = 7.84;

impl Altered {
    fn new(seed: u64) -> Self {
        let mut altered = Self {
            pilot: Box::default(),
            frame: Box::new(DepthFrame::EMPTY),
            blocks: vec![0.0; DEPTH_ROWS * DEPTH_COLS / (BLOCK * BLOCK)],
            state: seed,
        };
        for i in 0..altered.blocks.len() {
            altered.blocks[i] = COMMON_M * altered.normal();
        }
        altered
    }

    /// About normal: the sum of four uniform numbers, from splitmix64.
    fn normal(&mut self) -> f32 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        let sum: u64 = (0..4).map(|i| z >> (16 * i) & 0xFFFF).sum();
        (sum as f32 / 65535.0 - 2.0) * 1.732
    }
}

impl Pilot for Altered {
    fn decide(&mut self, input: &PilotInput<'_>) -> Action {
        for i in 0..self.blocks.len() {
            // Correlated 0.67 after five steps.
            self.blocks[i] = 0.923 * self.blocks[i] + 0.385 * COMMON_M * self.normal();
        }
        self.frame.header = input.depth.header;
        for (i, clean) in input.depth.depth.iter().enumerate() {
            let block = i / DEPTH_COLS / BLOCK * (DEPTH_COLS / BLOCK) + i % DEPTH_COLS / BLOCK;
            let by_m = (self.blocks[block] + OWN_M * self.normal()).clamp(-LIMIT_M, LIMIT_M);
            self.frame.depth[i] = (clean + by_m / DEPTH_FULL_SCALE_M).clamp(0.0, 1.0);
        }
        let input = PilotInput {
            depth: &self.frame,
            ..*input
        };
        self.pilot.observe(&input, true);
        self.pilot.decide(&input)
    }

    fn reset(&mut self) {}
}

#[test]
fn columns_walls_and_gaps_are_passed_as_open_space_is() {
    let gap = [block([8.0, 8.3], [-12.0, 2.0]), block([8.0, 8.3], [4.5, 12.0])];
    let rows_of_columns = (0..4).flat_map(|row: u8| {
        (0..4).map(move |i: u8| {
            let north = 4.0 + 4.0 * f32::from(row);
            column(north, -6.0 + 4.0 * f32::from(i) + 2.0 * f32::from(row % 2), 0.35)
        })
    });
    for (solids, limit_s) in [
        (vec![], 60.0),
        (vec![column(6.0, 0.0, 0.3)], 90.0),
        (vec![block([8.0, 8.3], [-6.0, 3.0])], 90.0),
        (gap.to_vec(), 90.0),
        (rows_of_columns.collect(), 90.0),
    ] {
        let f = fly(&Scene::new(solids), &mut Altered::new(1), 0.0, (20.0, 0.0), limit_s);
        f.assert_arrived(0.31);
    }
}
