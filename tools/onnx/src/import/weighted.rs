//! Layers with weights: dense ones, convolutions, pooling, normalisation, means and sums.

use super::elementwise::spread;
use super::importer::{Importer, Live, broadcast, identity, image_places, positive};
use crate::constant::{Constant, len_of};
use crate::fold;
use crate::movement::{axis, transpose};
use crate::proto::Node;
use std::rc::Rc;
use vigil_nnet::{Activation, Conv2d, Dense, LayerNorm, MaxPool2d};
use vigil_policy::imported::Layer;

impl Importer<'_> {
    /// `y = x W + b` with `W` `[x's values][outputs]`.
    pub(super) fn dense(
        &mut self,
        x: &Live,
        weights: &[f32],
        outputs: usize,
        bias: Option<&[f32]>,
    ) -> Result<Live, String> {
        let x = self.narrowed(x)?;
        let inputs = self.lens.get(x.layer).copied().unwrap_or(0);
        let len = len_of(&[inputs + 1, outputs])?;
        if weights.len() != x.places.len() * outputs || outputs == 0 {
            return Err(format!(
                "weights of {} values for {} inputs and {outputs} outputs",
                weights.len(),
                x.places.len()
            ));
        }
        let mut params = vec![0.0; len];
        for (row, place) in weights.chunks_exact(outputs).zip(x.places.iter()) {
            let at = *place as usize * outputs;
            // One value may stand in two places of the tensor.
            for (to, from) in params[at..at + outputs].iter_mut().zip(row) {
                *to += from;
            }
        }
        if let Some(bias) = bias {
            let bias = broadcast(bias, outputs)?;
            params[inputs * outputs..].copy_from_slice(&bias);
        }
        let layer = Layer::Dense {
            x: x.layer,
            layer: Dense { inputs, outputs },
            curve: Activation::Identity,
        };
        let layer = self.push(layer, params, outputs)?;
        Ok(Live::of(layer, vec![1, outputs], identity(outputs)))
    }

    pub(super) fn gemm(&mut self, node: &Node) -> Result<Live, String> {
        node.only("transA", 0)?;
        let (x, w) = (self.live(node, 0)?, self.constant(node, 1)?);
        let (alpha, beta) = (node.real("alpha", 1.0), node.real("beta", 1.0));
        let [rows, cols] = *w.shape.as_slice() else {
            return Err(format!("weights of shape {:?}", w.shape));
        };
        let (outputs, places) = match node.whole("transB", 0) {
            0 => (cols, (0..rows * cols).collect()),
            _ => (rows, transpose(&w.shape, &[1, 0])?.1),
        };
        let values = w.real()?;
        let weights: Vec<f32> = places.iter().map(|place| alpha * values[*place]).collect();
        let bias = self.optional(node, 2)?;
        let bias: Option<Vec<f32>> = match &bias {
            Some(bias) => Some(bias.real()?.iter().map(|value| beta * value).collect()),
            None => None,
        };
        self.dense(&x, &weights, outputs, bias.as_deref())
    }

    pub(super) fn mat_mul(&mut self, node: &Node) -> Result<Live, String> {
        let (x, w) = (self.live(node, 0)?, self.constant(node, 1)?);
        let [inputs, outputs] = *w.shape.as_slice() else {
            return Err(format!("weights of shape {:?}", w.shape));
        };
        if x.places.len() != inputs {
            return Err(format!("{:?} times {:?}: one row only", x.shape, w.shape));
        }
        let mut live = self.dense(&x, w.real()?, outputs, None)?;
        live.shape = x.shape.clone();
        if let Some(last) = live.shape.last_mut() {
            *last = outputs;
        }
        Ok(live)
    }

    /// A node's first input, which is an image; its channels, rows and columns.
    fn image_values(&self, node: &Node) -> Result<(Live, [usize; 3]), String> {
        let x = self.live(node, 0)?;
        match *x.shape.as_slice() {
            [1, channels, rows, cols] => Ok((x, [channels, rows, cols])),
            ref shape => Err(format!(
                "an input of shape {shape:?} instead of [1, channels, rows, columns]"
            )),
        }
    }

    /// The layer of an image, and its channels, rows and columns.
    fn image(&mut self, node: &Node) -> Result<(usize, [usize; 3]), String> {
        let (x, [channels, rows, cols]) = self.image_values(node)?;
        let x = self.narrowed(&x)?;
        let whole = self.lens.get(x.layer) == Some(&x.places.len());
        if !whole || *x.places != image_places(channels, rows, cols) {
            return Err("its image was cut, joined or reordered before; that is not supported".to_owned());
        }
        Ok((x.layer, [channels, rows, cols]))
    }

    /// Refuses padding that is not written out.
    fn refuse_auto_pad(node: &Node) -> Result<(), String> {
        let pad = node.word("auto_pad");
        match pad.filter(|pad| pad != "NOTSET" && pad != "VALID") {
            Some(pad) => Err(format!(
                "auto_pad = {pad} is not supported: export it with explicit padding"
            )),
            None => Ok(()),
        }
    }

    /// Width with its dilation, stride, padding and dilation of a kernel, which have to be the same both ways.
    fn window(node: &Node, height: usize, width: usize) -> Result<[usize; 4], String> {
        if height != width || height == 0 {
            return Err(format!("a kernel of {height} × {width} is not supported: squares only"));
        }
        Self::refuse_auto_pad(node)?;
        node.only("ceil_mode", 0)?;
        let same = |what: &str, default: i64| match node.list(what) {
            None | Some([]) => Ok(default),
            Some([first, rest @ ..]) if rest.iter().all(|other| other == first) => Ok(*first),
            Some(other) => Err(format!(
                "{what} = {other:?} is not supported: the same on all sides only"
            )),
        };
        let padding = usize::try_from(same("pads", 0)?).map_err(|_| "negative padding is not supported".to_owned())?;
        let [stride, dilation] = ["strides", "dilations"].map(|what| same(what, 1).and_then(|n| positive(n, what)));
        let (stride, dilation) = (stride?, dilation?);
        // A dilated kernel is a larger one with zeros between.
        let kernel = (height - 1).saturating_mul(dilation).saturating_add(1);
        match padding < kernel {
            true => Ok([kernel, stride, padding, dilation]),
            false => Err("padding as large as the kernel is not supported".to_owned()),
        }
    }

    /// A square kernel with its stride and padding, for pooling.
    fn square(node: &Node) -> Result<[usize; 3], String> {
        let (height, width) = Self::kernel_shape(node)?;
        match Self::window(node, height, width)? {
            [kernel, stride, padding, 1] => Ok([kernel, stride, padding]),
            _ => Err("dilations of pooling are not supported".to_owned()),
        }
    }

    fn convolve(&mut self, x: usize, layer: Conv2d, params: Vec<f32>) -> Result<Live, String> {
        layer.validate().map_err(|e| e.to_string())?;
        let (rows, cols, filters) = (layer.out_rows(), layer.out_cols(), layer.filters);
        let len = len_of(&[rows, cols, filters])?;
        let curve = Activation::Identity;
        let layer = self.push(Layer::Conv2d { x, layer, curve }, params, len)?;
        let places = Rc::new(image_places(filters, rows, cols));
        Ok(Live::of(layer, vec![1, filters, rows, cols], places))
    }

    pub(super) fn conv(&mut self, node: &Node) -> Result<Live, String> {
        let (x, [channels, rows, cols]) = self.image(node)?;
        let w = self.constant(node, 1)?;
        let [filters, depth, height, width] = *w.shape.as_slice() else {
            return Err(format!("weights of shape {:?}: two dimensions only", w.shape));
        };
        let groups = positive(node.whole("group", 1), "group")?;
        if depth.checked_mul(groups) != Some(channels) || !filters.is_multiple_of(groups) {
            let shape = &w.shape;
            return Err(format!(
                "weights of shape {shape:?} in {groups} groups for {channels} channels"
            ));
        }
        let [kernel, stride, padding, dilation] = Self::window(node, height, width)?;
        let layer = Conv2d::new([rows, cols, channels], filters, kernel, stride, padding);
        let taps = len_of(&[kernel, kernel, channels, filters])?;
        let mut params = vec![0.0; taps + filters];
        for (i, value) in w.real()?.iter().enumerate() {
            let (filter, rest) = (i / (depth * height * width), i % (depth * height * width));
            let (channel, tap) = (rest / (height * width), rest % (height * width));
            let tap = (tap / width * kernel + tap % width) * dilation;
            let channel = filter / (filters / groups) * depth + channel;
            params[(tap * channels + channel) * filters + filter] = *value;
        }
        if let Some(bias) = self.optional(node, 2)? {
            params[taps..].copy_from_slice(&broadcast(bias.real()?, filters)?);
        }
        self.convolve(x, layer, params)
    }

    fn kernel_shape(node: &Node) -> Result<(usize, usize), String> {
        match node.list("kernel_shape") {
            Some([height, width]) => Ok((positive(*height, "kernel")?, positive(*width, "kernel")?)),
            other => Err(format!("kernel_shape = {other:?}")),
        }
    }

    pub(super) fn max_pool(&mut self, node: &Node) -> Result<Live, String> {
        Self::refuse_auto_pad(node)?;
        let (x, [channels, rows, cols]) = self.image(node)?;
        let whole = match node.op_type.as_str() {
            "MaxPool" => Self::kernel_shape(node)? == (rows, cols),
            _ => true,
        };
        let pads = node.list("pads").unwrap_or_default();
        let mut layer = MaxPool2d::tiles(rows, cols, channels, 1);
        if whole && pads.iter().all(|pad| *pad == 0) {
            layer.window = [rows, cols];
        } else {
            let [window, stride, padding] = Self::square(node)?;
            (layer.window, layer.stride, layer.padding) = ([window; 2], stride, padding);
        }
        layer.validate().map_err(|e| e.to_string())?;
        let (rows, cols) = (layer.out_rows(), layer.out_cols());
        let layer = self.push(Layer::MaxPool2d { x, layer }, Vec::new(), rows * cols * channels)?;
        let places = Rc::new(image_places(channels, rows, cols));
        Ok(Live::of(layer, vec![1, channels, rows, cols], places))
    }

    /// A convolution whose weights are all the same, each channel for itself.
    pub(super) fn average_pool(&mut self, node: &Node) -> Result<Live, String> {
        let (x, [channels, rows, cols]) = self.image(node)?;
        let [kernel, stride, padding] = Self::square(node)?;
        if padding != 0 && node.whole("count_include_pad", 0) == 0 {
            return Err("padding that does not count is not supported: count_include_pad = 1, or none".to_owned());
        }
        let layer = Conv2d::new([rows, cols, channels], channels, kernel, stride, padding);
        let mut params = vec![0.0; len_of(&[kernel, kernel, channels, channels])? + channels];
        for tap in 0..kernel * kernel {
            for channel in 0..channels {
                params[(tap * channels + channel) * channels + channel] = 1.0 / (kernel * kernel) as f32;
            }
        }
        self.convolve(x, layer, params)
    }

    pub(super) fn batch_norm(&mut self, node: &Node) -> Result<Live, String> {
        // Before operator set 14 further outputs alone say so.
        if node.whole("training_mode", 0) != 0 || node.output.iter().skip(1).any(|name| !name.is_empty()) {
            return Err("it is in training mode: export the model after .eval()".to_owned());
        }
        let x = self.live(node, 0)?;
        let Some(channels) = x.shape.get(1).copied() else {
            return Err(format!("an input of shape {:?}", x.shape));
        };
        let epsilon = node.real("epsilon", 1e-5);
        let rows: Vec<Rc<Constant>> = (1..5).map(|i| self.constant(node, i)).collect::<Result<_, _>>()?;
        let row = |i: usize| rows[i].real();
        if rows.iter().any(|row| row.len() != channels) {
            return Err(format!("statistics for another number than {channels} channels"));
        }
        // As factors and summands, so that they can go into the layer before.
        let (mut factors, mut summands) = (Vec::new(), Vec::new());
        for channel in 0..channels {
            let [scale, shift, mean, variance] =
                [row(0)?[channel], row(1)?[channel], row(2)?[channel], row(3)?[channel]].map(f64::from);
            if variance + f64::from(epsilon) <= 0.0 {
                return Err(format!("channel {channel} has a variance of {variance}"));
            }
            let factor = scale / (variance + f64::from(epsilon)).sqrt();
            factors.push(factor as f32);
            summands.push((shift - factor * mean) as f32);
        }
        // Several rows have the same channels.
        let inner = x.shape.iter().skip(2).product::<usize>().max(1);
        let each = |values: &[f32]| -> Vec<f32> {
            let of = |i: usize| values[i / inner % channels];
            (0..x.places.len()).map(of).collect()
        };
        let (factors, summands) = (each(&factors), each(&summands));
        self.scaled(&x, &factors, &summands)
    }

    pub(super) fn layer_norm(&mut self, node: &Node) -> Result<Live, String> {
        let x = self.live(node, 0)?;
        let from = axis(node.whole("axis", -1), x.shape.len())?;
        let width = len_of(&x.shape[from..])?;
        let scale = spread(self.constant(node, 1)?.as_ref(), &x.shape[from..])?;
        let shift = match self.optional(node, 2)? {
            Some(shift) => spread(shift.as_ref(), &x.shape[from..])?,
            None => vec![0.0; width],
        };
        let epsilon = node.real("epsilon", 1e-5);
        if !(epsilon > 0.0 && epsilon.is_finite()) {
            return Err(format!("epsilon = {epsilon} is not supported: above 0"));
        }
        let (shape, n) = (x.shape.clone(), x.places.len());
        let x = self.narrowed(&x)?;
        // All of an image together: in its own order.
        let places = match width == n && self.is_whole(&x) {
            true => x.places.clone(),
            false => identity(n),
        };
        let mut params = [scale, shift].concat();
        if width == n {
            let ordered: Vec<f32> = params.clone();
            for (half, values) in params.chunks_exact_mut(n).zip(ordered.chunks_exact(n)) {
                for (place, value) in places.iter().zip(values) {
                    half[*place as usize] = *value;
                }
            }
        }
        let x = self.arranged_as(&x, &places)?;
        let layer = LayerNorm { width, epsilon };
        let layer = self.push(Layer::LayerNorm { x, layer }, params, n)?;
        Ok(Live::of(layer, shape, places))
    }

    /// Means and sums along axes: a layer whose weights are all the same.
    pub(super) fn reduce(&mut self, node: &Node) -> Result<Live, String> {
        let x = self.live(node, 0)?;
        let (along, shape) = match node.op_type.as_str() {
            "GlobalAveragePool" => {
                let (_, [channels, ..]) = self.image_values(node)?;
                (vec![false, false, true, true], vec![1, channels, 1, 1])
            }
            _ => self.reduction(node, &x.shape)?,
        };
        let places = fold::reduced_places(&x.shape, &along)?;
        let (n, outputs) = (x.places.len(), len_of(&shape)?);
        let weight = match node.op_type.as_str() {
            "ReduceSum" => 1.0,
            _ => outputs as f32 / n as f32,
        };
        let mut weights = vec![0.0; len_of(&[n, outputs])?];
        for (i, place) in places.into_iter().enumerate() {
            weights[i * outputs + place] = weight;
        }
        let mut live = self.dense(&x, &weights, outputs, None)?;
        live.shape = shape;
        Ok(live)
    }

    /// The largest value of each channel of an image.
    pub(super) fn reduce_max(&mut self, node: &Node) -> Result<Live, String> {
        let x = self.live(node, 0)?;
        let (along, shape) = self.reduction(node, &x.shape)?;
        if along != [false, false, true, true] {
            return Err("the largest of other than an image's rows and columns is not supported".to_owned());
        }
        let live = self.max_pool(node)?;
        Ok(Live { shape, ..live })
    }
}
