//! Convolutions of bytes against those of float32, and every instruction set against every other.

mod common;

use common::{rng, uniform};
use rand::RngExt;
use vigil_nnet::{Activation, Conv2d, Int8Chain, Isa};

fn shape(rows: usize, cols: usize, channels: usize, filters: usize, kernel: usize, stride: usize) -> Conv2d {
    Conv2d {
        rows,
        cols,
        channels,
        filters,
        kernel,
        stride,
        padding: kernel / 2,
    }
}

/// The layer behind one, with the same stride.
fn behind(layer: Conv2d, filters: usize, kernel: usize) -> Conv2d {
    let (rows, cols) = (layer.out_rows(), layer.out_cols());
    shape(rows, cols, layer.filters, filters, kernel, layer.stride)
}

/// Values from 0 to 1.
fn image(seed: u64, len: usize) -> Vec<f32> {
    uniform(&mut rng(seed), len, 0.5).iter().map(|x| x + 0.5).collect()
}

fn chain(input: Activation, layers: &[(Conv2d, Vec<f32>)]) -> Int8Chain {
    Int8Chain::new(input, layers.iter().map(|(layer, params)| (*layer, params.as_slice()))).unwrap()
}

fn int8(isa: Isa, input: Activation, layers: &[(Conv2d, Vec<f32>)], x: &[f32]) -> Vec<f32> {
    let mut y = vec![0.0; layers.last().unwrap().0.output_len()];
    chain(input, layers).forward(isa, x, &mut y).unwrap();
    y
}

fn float32(input: Activation, layers: &[(Conv2d, Vec<f32>)], x: &[f32]) -> Vec<f32> {
    let mut x = x.to_vec();
    input.apply_in_place(Isa::PORTABLE, &mut x);
    for (layer, params) in layers {
        let mut y = vec![0.0; layer.output_len()];
        layer
            .forward(Isa::PORTABLE, params, Activation::Elu, &x, None, &mut y)
            .unwrap();
        x = y;
    }
    x
}

fn rms(x: impl Iterator<Item = f32>) -> f32 {
    let (sum, n) = x.fold((0.0, 0.0), |(sum, n), x| (sum + x * x, n + 1.0));
    (sum / n).sqrt()
}

#[test]
fn whole_steps_are_multiplied_exactly() {
    for (seed, layer) in (0..).zip([
        shape(9, 13, 1, 16, 5, 2),
        shape(8, 11, 3, 48, 3, 1),
        shape(5, 40, 32, 32, 3, 2),
        shape(4, 4, 7, 16, 1, 1),
        Conv2d {
            padding: 0,
            ..shape(7, 20, 2, 32, 4, 3)
        },
    ]) {
        let mut rng = rng(seed);
        let x: Vec<f32> = (0..layer.input_len())
            .map(|_| f32::from(rng.random_range(0..=255_u8)) / 255.0)
            .collect();
        let mut params: Vec<f32> = (0..layer.param_len())
            .map(|_| f32::from(rng.random_range(-127..=127_i8)) / 127.0)
            .collect();
        params[..layer.filters].fill(1.0); // the largest of each filter
        let layers = [(layer, params)];
        let want = float32(Activation::Identity, &layers, &x);
        for isa in Isa::available() {
            for (got, want) in int8(isa, Activation::Identity, &layers, &x).iter().zip(&want) {
                assert!(
                    (got - want).abs() < 1e-5 * (1.0 + want.abs()),
                    "{got} {want} on {}",
                    isa.name()
                );
            }
        }
    }
}

#[test]
fn every_instruction_set_gives_the_same_bits_near_those_of_float32() {
    for (seed, first) in (0..).zip([
        shape(64, 96, 1, 16, 5, 2),
        shape(33, 47, 1, 48, 3, 2),
        shape(21, 18, 4, 32, 3, 1),
    ]) {
        let second = behind(first, 32, 3);
        let third = behind(second, 16, 3);
        // Weights as large as training leaves them, and a hundred times so: then values reach far.
        for gain in [1.0, 100.0] {
            let layers = [first, second, third].map(|layer| {
                let limit = gain / ((layer.kernel * layer.kernel * layer.channels) as f32).sqrt();
                (layer, uniform(&mut rng(seed), layer.param_len(), limit))
            });
            let x = image(seed, first.input_len());
            let got = int8(Isa::PORTABLE, Activation::NEAR_CONTRAST, &layers, &x);
            for isa in Isa::available() {
                let same = int8(isa, Activation::NEAR_CONTRAST, &layers, &x);
                assert!(got == same, "other bits on {}", isa.name());
            }
            let want = float32(Activation::NEAR_CONTRAST, &layers, &x);
            let error = rms(got.iter().zip(&want).map(|(a, b)| a - b)) / rms(want.iter().copied());
            assert!(error < 0.05, "{error} of the values, weights times {gain}");
        }
    }
}

#[test]
fn a_value_that_is_not_a_number_is_not_hidden_and_the_next_image_is_as_ever() {
    let layers = [shape(16, 16, 1, 16, 3, 2)].map(|layer| (layer, uniform(&mut rng(1), layer.param_len(), 0.3)));
    for isa in Isa::available() {
        for input in [Activation::Identity, Activation::NEAR_CONTRAST] {
            let mut chain = chain(input, &layers);
            let mut x = image(2, 256);
            let (mut first, mut second) = (vec![0.0; 1024], vec![0.0; 1024]);
            chain.forward(isa, &x, &mut first).unwrap();
            let kept = x[77];
            x[77] = f32::NAN;
            chain.forward(isa, &x, &mut second).unwrap();
            assert!(second.iter().all(|y| y.is_nan()));
            x[77] = kept;
            chain.forward(isa, &x, &mut second).unwrap();
            assert_eq!(first, second);
        }
        let beyond = int8(isa, Activation::Identity, &layers, &[f32::INFINITY; 256]);
        assert_eq!(beyond, int8(isa, Activation::Identity, &layers, &[1.0; 256]));
        let below = int8(isa, Activation::Identity, &layers, &[-3.0; 256]);
        assert_eq!(below, int8(isa, Activation::Identity, &layers, &[0.0; 256]));
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let layer = shape(16, 16, 1, 16, 3, 2);
    let params = vec![0.1; layer.param_len()];
    let refused = |input, layers: &[(Conv2d, &[f32])]| {
        let error = Int8Chain::new(input, layers.iter().copied()).unwrap_err();
        error.to_string()
    };
    let identity = Activation::Identity;
    assert!(refused(identity, &[]).contains("do not follow one another"));
    assert!(refused(identity, &[(layer, &params), (layer, &params)]).contains("do not follow one another"));
    assert!(refused(Activation::Relu, &[(layer, &params)]).contains("near contrast"));
    assert!(refused(identity, &[(layer, &params[1..])]).contains("parameters"));
    let odd = Conv2d { filters: 8, ..layer };
    assert!(refused(identity, &[(odd, &params[..odd.param_len()])]).contains("multiple of 16"));
    let mut chain = Int8Chain::new(identity, [(layer, params.as_slice())]).unwrap();
    let (x, mut y) = (vec![0.0; 256], vec![0.0; layer.output_len()]);
    assert!(chain.forward(Isa::detect(), &x[1..], &mut y).is_err());
    assert!(chain.forward(Isa::detect(), &x, &mut y[1..]).is_err());
}
