//! Nodes whose inputs are all constants: bounds made of two numbers, shapes that are computed, statistics with an epsilon. They
//! become constants.

use crate::constant::{Constant, Data, len_of};
use crate::movement::{axis, steps, strided};
use std::rc::Rc;

const MIXED: &str = "one of its constants is of whole numbers, the other of real ones";

/// The shape of two together, as NumPy broadcasts them.
pub fn broadcast_shape(a: &[usize], b: &[usize]) -> Result<Vec<usize>, String> {
    let rank = a.len().max(b.len());
    let size = |shape: &[usize], i: usize| {
        let missing = rank - shape.len();
        i.checked_sub(missing).and_then(|i| shape.get(i)).copied().unwrap_or(1)
    };
    let joined = (0..rank).map(|i| match (size(a, i), size(b, i)) {
        (a, b) if a == b || b == 1 => Some(a),
        (1, b) => Some(b),
        _ => None,
    });
    joined
        .collect::<Option<_>>()
        .ok_or_else(|| format!("the shapes {a:?} and {b:?} do not fit each other"))
}

/// Where each value of `shape` is in what is spread to it, whose own shape is `own`.
pub fn spread_places(own: &[usize], shape: &[usize]) -> Result<Vec<usize>, String> {
    let wrong = || format!("the shape {own:?} cannot be spread to {shape:?}");
    let missing = shape.len().checked_sub(own.len()).ok_or_else(wrong)?;
    let own: Vec<usize> = std::iter::repeat_n(1, missing).chain(own.iter().copied()).collect();
    if own.iter().zip(shape).any(|(own, size)| *own != 1 && own != size) {
        return Err(wrong());
    }
    let once = |(size, step): (&usize, usize)| if *size == 1 { 0 } else { step };
    let steps: Vec<usize> = own.iter().zip(steps(&own)).map(once).collect();
    strided(shape, &steps)
}

/// The axes that a reduction goes along, and the shape that it leaves.
pub type Reduction = (Vec<bool>, Vec<usize>);

/// Of values of `shape`.
pub fn reduced(shape: &[usize], axes: Option<&[i64]>, keep: bool, noop: bool) -> Result<Reduction, String> {
    let mut along = vec![matches!(axes, None | Some([])) && !noop; shape.len()];
    for given in axes.unwrap_or_default() {
        along[axis(*given, shape.len())?] = true;
    }
    let sizes = shape.iter().zip(&along);
    let left = sizes.filter_map(|(size, along)| match (*along, keep) {
        (false, _) => Some(*size),
        (true, true) => Some(1),
        (true, false) => None,
    });
    let left = left.collect();
    Ok((along, left))
}

/// For each value of `shape` the place of what it is reduced to.
pub fn reduced_places(shape: &[usize], along: &[bool]) -> Result<Vec<usize>, String> {
    let kept: Vec<usize> = shape
        .iter()
        .zip(along)
        .map(|(size, along)| if *along { 1 } else { *size })
        .collect();
    // What is spread back over the reduced axes stands where it came from.
    spread_places(&kept, shape)
}

fn unary(operator: &str, x: f32) -> Option<f32> {
    Some(match operator {
        "Neg" => -x,
        "Abs" => x.abs(),
        "Exp" => libm::expf(x),
        "Log" => libm::logf(x),
        "Sqrt" => libm::sqrtf(x),
        "Reciprocal" => 1.0 / x,
        "Tanh" => libm::tanhf(x),
        "Sigmoid" => 1.0 / (1.0 + libm::expf(-x)),
        "Relu" => x.max(0.0),
        "Softplus" => libm::log1pf(libm::expf(x)),
        "Floor" => libm::floorf(x),
        "Ceil" => libm::ceilf(x),
        "Round" => libm::rintf(x),
        "Sign" if x == 0.0 => 0.0,
        "Sign" => x.signum(),
        "Erf" => libm::erff(x),
        _ => return None,
    })
}

fn binary(operator: &str, a: f32, b: f32) -> Option<f32> {
    Some(match operator {
        "Add" | "Sum" => a + b,
        "Sub" => a - b,
        "Mul" => a * b,
        "Div" => a / b,
        "Pow" => libm::powf(a, b),
        "Min" => a.min(b),
        "Max" => a.max(b),
        _ => return None,
    })
}

fn compared<T: PartialOrd>(operator: &str, a: T, b: T) -> Option<i64> {
    let is = match operator {
        "Equal" => a == b,
        "Greater" => a > b,
        "GreaterOrEqual" => a >= b,
        "Less" => a < b,
        "LessOrEqual" => a <= b,
        _ => return None,
    };
    Some(i64::from(is))
}

/// Whole numbers: shapes and indices that are computed.
fn whole_binary(operator: &str, a: i64, b: i64) -> Option<i64> {
    match operator {
        "Add" | "Sum" => a.checked_add(b),
        "Sub" => a.checked_sub(b),
        "Mul" => a.checked_mul(b),
        "Div" => a.checked_div(b),
        "Mod" => a.checked_rem_euclid(b),
        "Min" => Some(a.min(b)),
        "Max" => Some(a.max(b)),
        "And" => Some(a & b),
        "Or" => Some(a | b),
        _ => compared(operator, a, b),
    }
}

/// Two constants to one of a shape that both are spread to.
fn together(operator: &str, a: &Constant, b: &Constant) -> Result<Option<Constant>, String> {
    let shape = broadcast_shape(&a.shape, &b.shape)?;
    let places = spread_places(&a.shape, &shape)?
        .into_iter()
        .zip(spread_places(&b.shape, &shape)?);
    let is_comparison = compared(operator, 0.0, 0.0).is_some();
    let data = match (&a.data, &b.data) {
        (Data::Real(a), Data::Real(b)) if is_comparison => {
            let values = places.map(|(i, j)| compared(operator, *a.get(i)?, *b.get(j)?));
            values.collect::<Option<_>>().map(Data::Whole)
        }
        (Data::Real(a), Data::Real(b)) => {
            let values = places.map(|(i, j)| binary(operator, *a.get(i)?, *b.get(j)?));
            values.collect::<Option<_>>().map(Data::Real)
        }
        (Data::Whole(a), Data::Whole(b)) => {
            let values = places.map(|(i, j)| whole_binary(operator, *a.get(i)?, *b.get(j)?));
            values.collect::<Option<_>>().map(Data::Whole)
        }
        // Powers of whole exponents.
        (Data::Real(_), Data::Whole(_)) if operator == "Pow" => return together(operator, a, &b.cast(1)?),
        _ => return Err(MIXED.to_owned()),
    };
    Ok(data.map(|data| Constant { shape, data }))
}

/// The first with each of the others, one after the other.
fn in_turn<'a>(
    first: &Constant,
    others: impl Iterator<Item = (&'a Rc<Constant>, &'a str)>,
) -> Result<Option<Constant>, String> {
    let mut all = first.clone();
    for (next, operator) in others {
        match together(operator, &all, next)? {
            Some(joined) => all = joined,
            None => return Ok(None),
        }
    }
    Ok(Some(all))
}

/// What an element-wise operator makes of constants; `None` where it is none of those.
///
/// # Errors
/// Shapes or kinds of number that do not fit each other.
pub fn fold(operator: &str, inputs: &[Rc<Constant>]) -> Result<Option<Constant>, String> {
    match (operator, inputs) {
        (_, [x]) => {
            let data = match (&x.data, operator) {
                (_, "Not") => Some(Data::Whole(x.whole()?.iter().map(|x| i64::from(*x == 0)).collect())),
                (Data::Real(values), _) => {
                    let values: Option<Vec<f32>> = values.iter().map(|x| unary(operator, *x)).collect();
                    values.map(Data::Real)
                }
                (Data::Whole(values), "Neg") => Some(Data::Whole(values.iter().map(|x| x.wrapping_neg()).collect())),
                (Data::Whole(_), _) => None,
            };
            let shape = x.shape.clone();
            Ok(data.map(|data| Constant { shape, data }))
        }
        ("Where", [condition, a, b]) => {
            let shape = broadcast_shape(&broadcast_shape(&condition.shape, &a.shape)?, &b.shape)?;
            let chosen = condition.whole()?;
            let places = spread_places(&condition.shape, &shape)?;
            let (of_a, of_b) = (spread_places(&a.shape, &shape)?, spread_places(&b.shape, &shape)?);
            let of_both = places.iter().zip(of_a.into_iter().zip(of_b));
            let picks = of_both.map(|(place, (a, b))| match chosen.get(*place) {
                None | Some(0) => (1, b),
                Some(_) => (0, a),
            });
            let data = Constant::picked(&[a, b], &picks.collect::<Vec<_>>()).map_err(|_| MIXED.to_owned())?;
            Ok(Some(Constant { shape, data }))
        }
        // In the order that the standard has: first up to the least, then down to the most.
        ("Clip", [x, bounds @ ..]) => in_turn(x, bounds.iter().zip(["Max", "Min"])),
        (_, [first, rest @ ..]) => in_turn(first, rest.iter().map(|next| (next, operator))),
        (_, []) => Ok(None),
    }
}

/// A reduction of a constant along axes: mean, sum, product, least or most.
///
/// # Errors
/// Whole numbers other than a product, as a shape's is.
pub fn reduce(operator: &str, x: &Constant, along: &[bool], shape: Vec<usize>) -> Result<Constant, String> {
    let (places, len) = (reduced_places(&x.shape, along)?, len_of(&shape)?);
    let real = |start: f32, with: fn(f32, f32) -> f32| x.real().map(|all| joined(all, &places, vec![start; len], with));
    let data = match (&x.data, operator) {
        (Data::Whole(all), "ReduceProd") => Data::Whole(joined(all, &places, vec![1; len], i64::wrapping_mul)),
        (Data::Whole(all), "ReduceSum") => Data::Whole(joined(all, &places, vec![0; len], i64::wrapping_add)),
        (_, "ReduceMax") => Data::Real(real(f32::NEG_INFINITY, f32::max)?),
        (_, "ReduceMin") => Data::Real(real(f32::INFINITY, f32::min)?),
        (_, "ReduceProd") => Data::Real(real(1.0, |a, b| a * b)?),
        _ => {
            let mut all = real(0.0, |a, b| a + b)?;
            if operator == "ReduceMean" {
                let count = (x.len() / len.max(1)) as f32;
                all.iter_mut().for_each(|sum| *sum /= count);
            }
            Data::Real(all)
        }
    };
    Ok(Constant { shape, data })
}

/// What has the same place, one after the other.
fn joined<T: Copy>(values: &[T], places: &[usize], mut all: Vec<T>, with: fn(T, T) -> T) -> Vec<T> {
    for (value, place) in values.iter().zip(places) {
        all[*place] = with(all[*place], *value);
    }
    all
}
