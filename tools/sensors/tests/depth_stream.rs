//! A depth camera's raw bytes become the part of the image that it sees.

use vigil_sensors::adapters::{DepthStream, Fault, SetupError};
use vigil_sensors::{Mount, Pinhole, View};
use vigil_types::{Attitude, DEPTH_COLS, DEPTH_PIXELS, FrdVector};

/// Of a camera that is mounted so, in units of so many metres.
fn stream_of(mount: Mount, metres_per_unit: f32) -> Result<DepthStream, SetupError> {
    let camera = Pinhole::new([320, 180], [165.0; 2], [159.5, 89.5]).unwrap();
    DepthStream::new(camera, mount, metres_per_unit)
}

#[test]
fn millimetres_of_a_wall_are_its_ranges_along_the_rays() {
    let mut stream = stream_of(Mount::STRAIGHT, 0.001).unwrap();
    let bytes: Vec<u8> = std::iter::repeat_n(2500u16.to_le_bytes(), 320 * 180)
        .flatten()
        .collect();
    let mut depth = Box::new([0.0; DEPTH_PIXELS]);
    stream.image(&bytes, &mut depth).expect("an image");
    let ahead = depth[64 * DEPTH_COLS + 128];
    // 30° to the right the wall is farther along the ray.
    let beside = depth[64 * DEPTH_COLS + 128 + 64];
    assert!((ahead - 0.025).abs() < 1e-5, "{ahead}");
    assert!(
        (beside - 0.025 / 30.234_f32.to_radians().cos()).abs() < 1e-4,
        "{beside}"
    );
    let view = stream.view;
    assert!((view.across_deg[1] - 44.0).abs() < 0.6 && !view.is_whole(), "{view}");
    let up_deg = [-0.2, 22.0];
    let upwards = View { up_deg, ..view }.to_string();
    assert!(upwards.contains(" 0° to 22° in height"), "{upwards}");
}

#[test]
fn half_an_image_and_an_image_of_nothing_are_named() {
    let mut stream = stream_of(Mount::STRAIGHT, 0.001).unwrap();
    let expected = stream.image_bytes();
    assert_eq!(expected, 2 * 320 * 180);
    let mut depth = Box::new([0.0; DEPTH_PIXELS]);
    for got in [0, expected - 1, expected + 1] {
        assert_eq!(
            stream.image(&vec![1; got], &mut depth),
            Err(Fault::ImageLength { got, expected })
        );
    }
    assert_eq!(stream.image(&vec![0; expected], &mut depth), Err(Fault::EmptyImage));
    assert!(stream_of(Mount::STRAIGHT, 1.0).is_err());
    let behind = Mount::new(FrdVector::ZERO, Attitude::from_euler_rad(0.0, 0.0, 3.0)).unwrap();
    assert_eq!(stream_of(behind, 0.001).err(), Some(SetupError::LooksElsewhere));
}
