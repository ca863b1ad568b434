//! What a picture costs. `cargo bench --profile release -p vigil-sensors`

use divan::Bencher;
use vigil_sensors::{Mount, Pinhole, Projector, Resolution};
use vigil_types::{DEPTH_PIXELS, FrdVector};

fn main() {
    divan::main();
}

/// One turn of a scanner with 128 rings of 1024 points.
#[divan::bench]
fn scanner_of_128_rings(bencher: Bencher<'_, '_>) {
    let mut projector = Projector::new(Resolution::of_degrees(0.35, 0.7).expect("valid"));
    let points: Vec<FrdVector> = (0..128 * 1024)
        .map(|i| {
            let (e, b) = ((i % 128) as f32 * 0.0123 - 0.78, (i / 128) as f32 * 0.006 - 3.0);
            FrdVector::new(e.cos() * b.cos(), e.cos() * b.sin(), -e.sin()) * (4.0 + b.sin())
        })
        .collect();
    let mut depth = [1.0; DEPTH_PIXELS];
    bencher.bench_local(|| {
        projector.add_points(&Mount::STRAIGHT, points.iter().copied());
        projector.finish(&mut depth)
    });
}

/// One depth image of 848 × 480 pixels.
#[divan::bench]
fn camera_of_848_by_480(bencher: Bencher<'_, '_>) {
    let camera = Pinhole::new([848, 480], [430.0; 2], [423.5, 239.5]).expect("valid");
    let mut projector = Projector::new(camera.resolution().expect("valid"));
    let image: Vec<u16> = (0..848 * 480).map(|i| 3000 + (i % 977) as u16).collect();
    let mut depth = [1.0; DEPTH_PIXELS];
    bencher.bench_local(|| {
        projector
            .add_depth_units(&Mount::STRAIGHT, &camera, &image, 0.001)
            .expect("its size");
        projector.finish(&mut depth)
    });
}
