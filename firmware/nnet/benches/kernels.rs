//! Layer timings, in sizes like the encoder's: `cargo bench --profile release -p vigil-nnet`. The actor's own are in
//! `firmware/policy/benches/network.rs`.

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vigil_nnet::{Activation, Aligned, Conv2d, Gru, Isa};

fn main() {
    println!(
        "processor offers: {:?}",
        isas().iter().map(|i| i.name()).collect::<Vec<_>>()
    );
    divan::main();
}

fn isas() -> Vec<Isa> {
    Isa::available().collect()
}

fn values(len: usize, limit: f32) -> Aligned {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let values: Vec<f32> = (0..len).map(|_| rng.random_range(-limit..limit)).collect();
    Aligned::from(&*values)
}

/// One convolution of the encoder on one instruction set.
struct Layer(usize, Isa);

impl std::fmt::Display for Layer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "conv {} {}", self.0 + 1, self.1)
    }
}

fn layers() -> Vec<Layer> {
    let each = |isa: Isa| (0..5).map(move |i| Layer(i, isa));
    isas().into_iter().rev().flat_map(each).collect()
}

/// Rows, columns, channels, filters, kernel.
const CONVOLUTIONS: [[usize; 5]; 5] = [
    [128, 256, 1, 16, 5],
    [64, 128, 16, 16, 3],
    [32, 64, 16, 32, 3],
    [16, 32, 32, 32, 3],
    [8, 16, 32, 32, 3],
];

fn layer(i: usize) -> Conv2d {
    let [rows, cols, channels, filters, kernel] = CONVOLUTIONS[i];
    Conv2d::new([rows, cols, channels], filters, kernel, 2, kernel / 2)
}

// Items are floating-point operations, so that the throughput column reads in FLOP/s.
fn flops(layer: &Conv2d) -> ItemsCount {
    ItemsCount::new(2 * layer.out_rows() * layer.out_cols() * layer.weight_len())
}

#[divan::bench(args = layers())]
fn convolution_forward(bencher: Bencher, case: &Layer) {
    let layer = layer(case.0);
    let (params, x) = (values(layer.param_len(), 0.1), values(layer.input_len(), 1.0));
    let mut y = Aligned::zeros(layer.output_len());
    bencher.counter(flops(&layer)).bench_local(|| {
        layer
            .forward(case.1, &params, Activation::Identity, black_box(&x), None, &mut y)
            .unwrap();
    });
}

#[divan::bench(args = layers())]
fn convolution_input_gradient(bencher: Bencher, case: &Layer) {
    let layer = layer(case.0);
    let (packed, dy) = (values(layer.param_len(), 0.1), values(layer.output_len(), 1.0));
    let mut dx = Aligned::zeros(layer.input_len());
    let mut scratch = Aligned::zeros(layer.input_gradient_scratch_len());
    bencher.counter(flops(&layer)).bench_local(|| {
        layer
            .input_gradient(case.1, &packed, black_box(&dy), &mut dx, &mut scratch)
            .unwrap();
    });
}

#[divan::bench(args = layers())]
fn convolution_weight_gradient(bencher: Bencher, case: &Layer) {
    let layer = layer(case.0);
    let (x, dy) = (values(layer.input_len(), 1.0), values(layer.output_len(), 1.0));
    let mut d_params = Aligned::zeros(layer.param_len());
    bencher.counter(flops(&layer)).bench_local(|| {
        layer
            .weight_gradient(case.1, black_box(&x), &dy, &mut d_params)
            .unwrap();
    });
}

#[divan::bench(args = Isa::available())]
fn elu_of_131072(bencher: Bencher, isa: Isa) {
    let (x, mut y) = (values(131_072, 2.0), vec![0.0; 131_072]);
    bencher.bench_local(|| Activation::Elu.apply(isa, black_box(&x), &mut y).unwrap());
}

#[divan::bench(args = Isa::available())]
fn gru_step(bencher: Bencher, isa: Isa) {
    let gru = Gru {
        inputs: layer(4).output_len(),
        hidden: 48,
    };
    let (params, x) = (values(gru.param_len(), 0.1), values(gru.inputs, 1.0));
    let (h, mut gates, mut out) = (values(48, 1.0), vec![0.0; gru.gates_len()], vec![0.0; 48]);
    bencher.bench_local(|| {
        gru.step(isa, &params, black_box(&x), &h, &mut gates, &mut out).unwrap();
    });
}

/// The rescale rule on 8 192 values (in cache) and on 131 072 (the first convolution's).
#[divan::bench(args = [8_192, 131_072])]
fn elu_multipliers(bencher: Bencher, len: usize) {
    let (x, x_ref) = (values(len, 2.0), values(len, 1.9));
    let (mut y, mut y_ref, mut m) = (vec![0.0; len], vec![0.0; len], vec![1.0; len]);
    Activation::Elu.apply(Isa::detect(), &x, &mut y).unwrap();
    Activation::Elu.apply(Isa::detect(), &x_ref, &mut y_ref).unwrap();
    bencher.counter(ItemsCount::new(len)).bench_local(|| {
        Activation::Elu
            .multipliers(Isa::detect(), (black_box(&x), &y), (&x_ref, &y_ref), &mut m)
            .unwrap();
    });
}
