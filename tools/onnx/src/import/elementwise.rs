//! Curves, arithmetic and functions of each value.

use super::importer::{Importer, Live, Value, identity, refuse_endless};
use crate::constant::{Constant, Data};
use crate::fold;
use crate::proto::Node;
use std::rc::Rc;
use vigil_nnet::{Activation, BatchNorm, Function};
use vigil_policy::imported::Layer;

impl Importer<'_> {
    /// An input of a node; of values, with whether nothing else uses them.
    fn operand(&self, node: &Node, i: usize) -> Result<Value, String> {
        match self.input(node, i)?.1 {
            Value::Live(_) => self.live(node, i).map(Value::Live),
            constant => Ok(constant),
        }
    }

    pub(super) fn affine(&mut self, node: &Node) -> Result<Live, String> {
        let (a, b) = (self.operand(node, 0)?, self.operand(node, 1)?);
        self.arithmetic(&node.op_type, &a, &b)
    }

    /// A sum, difference, product or quotient, of which one at least depends on the inputs.
    fn arithmetic(&mut self, operator: &str, a: &Value, b: &Value) -> Result<Live, String> {
        let (x, constant, swapped) = match (a, b) {
            (Value::Live(x), Value::Constant(constant)) => (x, constant, false),
            (Value::Constant(constant), Value::Live(x)) => (x, constant, true),
            (Value::Live(a), Value::Live(b)) => {
                let b = match operator {
                    "Sub" => self.moved_by(b, -1.0, 0.0)?,
                    "Div" => self.through(b, Function::Power { exponent: -1.0 })?,
                    _ => b.clone(),
                };
                return self.both(a, &b, matches!(operator, "Mul" | "Div"));
            }
            _ => return Err("constants of which one is of whole numbers, the other of real ones".to_owned()),
        };
        let x = spread_live(x, &fold::broadcast_shape(&x.shape, &constant.shape)?)?;
        let values = spread(constant, &x.shape)?;
        let n = values.len();
        let negated = || values.iter().map(|value| -value).collect::<Vec<f32>>();
        let (factors, summands) = match (operator, swapped) {
            ("Add", _) => (vec![1.0; n], values),
            ("Sub", false) => (vec![1.0; n], negated()),
            ("Sub", true) => (vec![-1.0; n], values),
            ("Mul", _) => (values, vec![0.0; n]),
            ("Div", false) => (values.iter().map(|value| 1.0 / value).collect(), vec![0.0; n]),
            _ => {
                let inverse = self.through(&x, Function::Power { exponent: -1.0 })?;
                return self.scaled(&inverse, &values, &vec![0.0; n]);
            }
        };
        if !factors.iter().all(|factor| factor.is_finite()) {
            return Err("it divides by zero".to_owned());
        }
        self.scaled(&x, &factors, &summands)
    }

    /// `y = factor · x + summand`.
    pub(super) fn moved_by(&mut self, x: &Live, factor: f32, summand: f32) -> Result<Live, String> {
        let n = x.places.len();
        self.scaled(x, &vec![factor; n], &vec![summand; n])
    }

    /// The sum or the product of two that both depend on the inputs, in the order of one that is a whole layer.
    fn both(&mut self, a: &Live, b: &Live, multiply: bool) -> Result<Live, String> {
        let shape = fold::broadcast_shape(&a.shape, &b.shape)?;
        let (a, b) = (spread_live(a, &shape)?, spread_live(b, &shape)?);
        let (a, b) = (self.narrowed(&a)?, self.narrowed(&b)?);
        let n = a.places.len();
        let places = match (self.is_whole(&a), self.is_whole(&b)) {
            (true, _) => a.places.clone(),
            (_, true) => b.places.clone(),
            _ => identity(n),
        };
        let (x, y) = (self.arranged_as(&a, &places)?, self.arranged_as(&b, &places)?);
        let layer = match multiply {
            true => Layer::Product { x, y },
            false => Layer::Sum { parts: vec![x, y] },
        };
        let layer = self.push(layer, Vec::new(), n)?;
        Ok(Live::of(layer, shape, places))
    }

    pub(super) fn function(&mut self, node: &Node, function: Function) -> Result<Live, String> {
        let x = self.live(node, 0)?;
        self.through(&x, function)
    }

    /// A function of each value.
    fn through(&mut self, x: &Live, function: Function) -> Result<Live, String> {
        self.of_each(x, |x| Layer::Function { x, function })
    }

    /// One of the curves of layers, as a layer of its own.
    fn curved(&mut self, x: &Live, curve: Activation) -> Result<Live, String> {
        self.of_each(x, |x| Layer::Curve { x, curve })
    }

    /// A layer of each value of the one before.
    fn of_each(&mut self, x: &Live, layer: impl FnOnce(usize) -> Layer) -> Result<Live, String> {
        let x = self.narrowed(x)?;
        let len = self.lens.get(x.layer).copied().unwrap_or(0);
        let layer = self.push(layer(x.layer), Vec::new(), len)?;
        Ok(Live::of(layer, x.shape, x.places))
    }

    pub(super) fn clip(&mut self, node: &Node) -> Result<Live, String> {
        let mut bounds = [f32::NEG_INFINITY, f32::INFINITY];
        for (i, (bound, name)) in bounds.iter_mut().zip(["min", "max"]).enumerate() {
            if let Some(constant) = self.optional(node, i + 1)? {
                match constant.real()? {
                    [one] => *bound = *one,
                    all => return Err(format!("{name} has {} values; one is allowed", all.len())),
                }
            } else if let Some(attribute) = node.get(name) {
                *bound = attribute.f;
            }
        }
        let [least, most] = bounds;
        self.function(node, Function::Clip { least, most })
    }

    /// The largest, the least or the sum of any number.
    pub(super) fn of_several(&mut self, node: &Node) -> Result<Value, String> {
        let mut all = self.operand(node, 0)?;
        for i in 1..node.input.len() {
            let next = self.operand(node, i)?;
            all = match (&all, &next) {
                (Value::Constant(a), Value::Constant(b)) => {
                    let folded = fold::fold(&node.op_type, &[a.clone(), b.clone()])?;
                    Value::Constant(Rc::new(folded.ok_or("constants that are not combined")?))
                }
                _ if node.op_type == "Sum" => Value::Live(self.arithmetic("Add", &all, &next)?),
                _ => Value::Live(self.extreme(&all, &next, node.op_type == "Max")?),
            };
        }
        Ok(all)
    }

    /// The larger or the smaller of two.
    fn extreme(&mut self, a: &Value, b: &Value, larger: bool) -> Result<Live, String> {
        let (x, other) = match (a, b) {
            (Value::Live(x), other) | (other, Value::Live(x)) => (x, other),
            _ => return Err("constants that are not combined".to_owned()),
        };
        // Both are read twice.
        let other = &match other {
            Value::Live(other) => Value::Live(other.clone().shared()),
            constant => constant.clone(),
        };
        if let Value::Constant(constant) = other {
            if let Ok([bound, rest @ ..]) = constant.real()
                && rest.iter().all(|other| other == bound)
            {
                let (least, most) = match larger {
                    true => (*bound, f32::INFINITY),
                    false => (f32::NEG_INFINITY, *bound),
                };
                let x = spread_live(x, &fold::broadcast_shape(&x.shape, &constant.shape)?)?;
                return self.through(&x, Function::Clip { least, most });
            }
            let constant = Constant::clone(constant).checked(false);
            constant.map_err(|_| "bounds of which some are infinite and others are not".to_owned())?;
        }
        // max(x, c) = c + relu(x − c), min(x, c) = c − relu(c − x): a bound for each value, or two that both vary.
        let shared = Value::Live(x.clone().shared());
        let above = match larger {
            true => self.arithmetic("Sub", &shared, other)?,
            false => self.arithmetic("Sub", other, &shared)?,
        };
        let above = Value::Live(self.curved(&above, Activation::Relu)?);
        self.arithmetic(if larger { "Add" } else { "Sub" }, other, &above)
    }

    pub(super) fn power(&mut self, node: &Node) -> Result<Live, String> {
        match (self.operand(node, 0)?, self.operand(node, 1)?) {
            (Value::Live(x), Value::Constant(exponent)) => {
                let exponents: Vec<f32> = match &exponent.data {
                    Data::Real(values) => values.clone(),
                    Data::Whole(values) => values.iter().map(|value| *value as f32).collect(),
                };
                match exponents.as_slice() {
                    [first, rest @ ..] if rest.iter().all(|other| other == first) => match *first {
                        1.0 => Ok(x),
                        exponent => self.through(&x, Function::Power { exponent }),
                    },
                    _ => Err("several exponents are not supported: one for all values".to_owned()),
                }
            }
            (Value::Constant(base), Value::Live(x)) => match base.real()? {
                [base] if *base > 0.0 => {
                    let x = self.moved_by(&x, libm::logf(*base), 0.0)?;
                    self.through(&x, Function::Exp)
                }
                _ => Err("a base that is not one number above 0 is not supported".to_owned()),
            },
            _ => Err("a base and an exponent that both depend on the inputs are not supported".to_owned()),
        }
    }

    /// Curves that are made of others.
    pub(super) fn composed(&mut self, node: &Node) -> Result<Live, String> {
        // It is read more than once.
        let x = self.live(node, 0)?.shared();
        let gate = match node.op_type.as_str() {
            "Selu" => {
                let alpha = node.real("alpha", 1.673_263_2);
                let y = self.through(&x, Function::Elu { alpha })?;
                return self.moved_by(&y, node.real("gamma", 1.050_701), 0.0);
            }
            "Celu" => {
                let alpha = node.real("alpha", 1.0);
                let y = self.moved_by(&x, 1.0 / alpha, 0.0)?;
                let y = self.through(&y, Function::Elu { alpha: 1.0 })?;
                // Above 0 it is x again.
                return self.moved_by(&y, alpha, 0.0);
            }
            "PRelu" => {
                // slope · x + (1 − slope) · relu(x)
                let slope = self.constant(node, 1)?;
                let one = Rc::new(Constant::one(Data::Real(vec![1.0])));
                let rest = fold::fold("Sub", &[one, slope.clone()])?.ok_or("slopes that are no numbers")?;
                let above = Value::Live(self.curved(&x, Activation::Relu)?);
                let above = self.arithmetic("Mul", &above, &Value::Constant(Rc::new(rest)))?;
                let below = self.arithmetic("Mul", &Value::Live(x), &Value::Constant(slope))?;
                return self.arithmetic("Add", &Value::Live(below), &Value::Live(above));
            }
            "HardSigmoid" | "HardSwish" => {
                let is_gate = node.op_type == "HardSwish";
                let (alpha, beta) = match is_gate {
                    true => (1.0 / 6.0, 0.5),
                    false => (node.real("alpha", 0.2), node.real("beta", 0.5)),
                };
                let y = self.moved_by(&x, alpha, beta)?;
                let y = self.through(&y, Function::Clip { least: 0.0, most: 1.0 })?;
                if !is_gate {
                    return Ok(y);
                }
                y
            }
            "Softsign" => {
                let y = self.through(&x, Function::Abs)?;
                let y = self.moved_by(&y, 1.0, 1.0)?;
                self.through(&y, Function::Power { exponent: -1.0 })?
            }
            "Mish" => {
                let y = self.through(&x, Function::Softplus)?;
                self.curved(&y, Activation::TANH)?
            }
            "Gelu" => {
                let y = match node.word("approximate").as_deref() {
                    Some("tanh") => {
                        let cube = self.through(&x, Function::Power { exponent: 3.0 })?;
                        let cube = self.moved_by(&cube, 0.044_715, 0.0)?;
                        let y = self.both(&x, &cube, false)?;
                        let y = self.moved_by(&y, (2.0 / std::f32::consts::PI).sqrt(), 0.0)?;
                        self.curved(&y, Activation::TANH)?
                    }
                    _ => {
                        let y = self.moved_by(&x, std::f32::consts::FRAC_1_SQRT_2, 0.0)?;
                        self.through(&y, Function::Erf)?
                    }
                };
                self.moved_by(&y, 0.5, 0.5)?
            }
            _ => {
                let y = self.moved_by(&x, node.real("alpha", 1.0), 0.0)?;
                self.curved(&y, Activation::Sigmoid)?
            }
        };
        self.both(&x, &gate, true)
    }

    /// `y = factor · x + summand`, each value of the tensor its own: in the layer before where that is possible.
    pub(super) fn scaled(&mut self, x: &Live, factors: &[f32], summands: &[f32]) -> Result<Live, String> {
        let mut len = self.lens.get(x.layer).copied().unwrap_or(0);
        let own;
        let (x, (factor, summand)) = match each_place(&x.places, len, factors, summands) {
            Some(both) => (x, both),
            // What stands in several places of the tensor has a factor for each.
            None => {
                len = x.places.len();
                let layer = self.arranged_as(x, &identity(len))?;
                own = Live::of(layer, x.shape.clone(), identity(len)).shared();
                (&own, (factors.to_vec(), summands.to_vec()))
            }
        };
        let result = |layer: usize| Live::of(layer, x.shape.clone(), x.places.clone());
        // Of an image, one for each channel if all pixels have the same.
        let channels = match *x.shape.as_slice() {
            [1, channels, _, _] if channels > 0 && len.is_multiple_of(channels) => channels,
            _ => len,
        };
        let uniform = |all: &[f32], n: usize| all.iter().enumerate().all(|(i, value)| *value == all[i % n]);
        let whole = x.alone && x.places.len() == len;
        if whole
            && let (Some(before), Some(params)) = (self.network.layers.get_mut(x.layer), self.params.get_mut(x.layer))
        {
            let outputs = match before {
                Layer::Dense { layer, curve, .. } if *curve == Activation::Identity => Some(layer.outputs),
                Layer::Conv2d { layer, curve, .. } if *curve == Activation::Identity => Some(layer.filters),
                _ => None,
            };
            if let Some(outputs) = outputs.filter(|n| uniform(&factor, *n) && uniform(&summand, *n)) {
                for row in params.chunks_exact_mut(outputs) {
                    row.iter_mut().zip(&factor).for_each(|(value, factor)| *value *= factor);
                }
                let bias = params.len() - outputs;
                let biases = params[bias..].iter_mut().zip(&summand);
                biases.for_each(|(value, summand)| *value += summand);
                return refuse_endless(params).map(|()| result(x.layer));
            }
            let all = factor.first().copied().unwrap_or(0.0);
            if let Layer::Dense { curve, .. } | Layer::Conv2d { curve, .. } | Layer::Curve { curve, .. } = before
                && let Activation::Tanh { scale } = curve
                && uniform(&factor, 1)
                && (*scale * all).is_normal()
                && all > 0.0
                && summand.iter().all(|s| *s == 0.0)
            {
                *scale *= all;
                return Ok(result(x.layer));
            }
        }
        let channels = match uniform(&factor, channels) && uniform(&summand, channels) {
            true => channels,
            false => len,
        };
        let rows = [&factor[..channels], &summand[..channels]].concat();
        let params = [rows, vec![0.0; channels], vec![1.0; channels]].concat();
        let layer = BatchNorm { channels, epsilon: 0.0 };
        let layer = self.push(Layer::BatchNorm { x: x.layer, layer }, params, len)?;
        Ok(result(layer))
    }

    pub(super) fn curve(&mut self, node: &Node, curve: Activation) -> Result<Live, String> {
        let x = self.live(node, 0)?;
        let len = self.lens.get(x.layer).copied().unwrap_or(0);
        if x.alone
            && x.places.len() == len
            && let Some(Layer::Dense { curve: own, .. } | Layer::Conv2d { curve: own, .. }) =
                self.network.layers.get_mut(x.layer)
            && *own == Activation::Identity
        {
            *own = curve;
            return Ok(x);
        }
        self.curved(&x, curve)
    }
}

/// A constant for each value of a shape, as NumPy broadcasts it.
pub(super) fn spread(constant: &Constant, shape: &[usize]) -> Result<Vec<f32>, String> {
    let values = constant.real()?;
    let own = if constant.len() == 1 { &[][..] } else { &constant.shape };
    let places = fold::spread_places(own, shape)
        .map_err(|_| format!("a constant of shape {:?} for values of shape {shape:?}", constant.shape))?;
    let picked: Option<Vec<f32>> = places.into_iter().map(|place| values.get(place).copied()).collect();
    picked.ok_or_else(|| "a value is missing".to_owned())
}

/// Factors and summands of a layer's values, of those that stand at `places` of it; `None` where one stands at several that differ.
fn each_place(places: &[u32], len: usize, factors: &[f32], summands: &[f32]) -> Option<(Vec<f32>, Vec<f32>)> {
    let (mut factor, mut summand) = (vec![1.0; len], vec![0.0; len]);
    let mut seen = vec![false; len];
    for ((place, f), s) in places.iter().zip(factors).zip(summands) {
        let place = *place as usize;
        if std::mem::replace(&mut seen[place], true) && (factor[place], summand[place]) != (*f, *s) {
            return None;
        }
        (factor[place], summand[place]) = (*f, *s);
    }
    Some((factor, summand))
}

/// Values spread to a shape, as NumPy broadcasts them.
fn spread_live(x: &Live, shape: &[usize]) -> Result<Live, String> {
    if x.shape == shape {
        return Ok(x.clone());
    }
    x.moved(shape.to_vec(), &fold::spread_places(&x.shape, shape)?)
}
