//! Constants of a graph: weights, shapes, indices.

use crate::proto::Tensor;
use vigil_policy::imported::MOST_VALUES;

/// A constant's numbers.
#[derive(Debug, Clone, PartialEq)]
pub enum Data {
    /// Weights.
    Real(Vec<f32>),
    /// Shapes, axes, indices.
    Whole(Vec<i64>),
}

/// A constant.
#[derive(Debug, Clone, PartialEq)]
pub struct Constant {
    /// Sizes; none for a single number.
    pub shape: Vec<usize>,
    /// Values, the last size running fastest.
    pub data: Data,
}

/// What a type of numbers that no constant here has is called.
fn type_name(number: i64) -> String {
    let named = [(2, "uint8"), (3, "int8"), (10, "float16"), (16, "bfloat16")];
    let found = named.iter().find(|(other, _)| *other == number);
    found.map_or_else(|| format!("type {number}"), |(_, name)| (*name).to_owned())
}

/// The number of values of a shape, if it is allowed.
pub fn len_of(shape: &[usize]) -> Result<usize, String> {
    let len = shape.iter().try_fold(1usize, |all, size| all.checked_mul(*size));
    len.filter(|len| *len as u64 <= MOST_VALUES)
        .ok_or_else(|| format!("the shape {shape:?} has more than {MOST_VALUES} values"))
}

impl Constant {
    /// A constant of the file.
    ///
    /// # Errors
    /// Another type of number, data that do not fill the shape.
    pub fn of(tensor: &Tensor) -> Result<Self, String> {
        if tensor.data_location == 1 {
            return Err("its data are in another file; save the model in one".to_owned());
        }
        let sizes: Option<Vec<usize>> = tensor.dims.iter().map(|size| usize::try_from(*size).ok()).collect();
        let shape = sizes.ok_or_else(|| format!("it has the sizes {:?}", tensor.dims))?;
        let len = len_of(&shape)?;
        let raw = tensor.raw_data.as_slice();
        fn chunks<const N: usize>(raw: &[u8]) -> impl Iterator<Item = [u8; N]> {
            raw.as_chunks::<N>().0.iter().copied()
        }
        let data = match tensor.data_type {
            1 if raw.is_empty() => Data::Real(tensor.float_data.clone()),
            1 => Data::Real(chunks(raw).map(f32::from_le_bytes).collect()),
            11 if raw.is_empty() => Data::Real(tensor.double_data.iter().map(|x| *x as f32).collect()),
            11 => Data::Real(chunks(raw).map(|b| f64::from_le_bytes(b) as f32).collect()),
            6 if raw.is_empty() => Data::Whole(tensor.int32_data.iter().map(|x| i64::from(*x)).collect()),
            6 => Data::Whole(chunks(raw).map(|b| i64::from(i32::from_le_bytes(b))).collect()),
            7 if raw.is_empty() => Data::Whole(tensor.int64_data.clone()),
            7 => Data::Whole(chunks(raw).map(i64::from_le_bytes).collect()),
            9 if raw.is_empty() => Data::Whole(tensor.int32_data.iter().map(|x| i64::from(*x != 0)).collect()),
            9 => Data::Whole(raw.iter().map(|b| i64::from(*b != 0)).collect()),
            other => {
                return Err(format!(
                    "it has numbers of {}; float32, float64, int32, int64 and bool are known",
                    type_name(i64::from(other))
                ));
            }
        };
        let constant = Self { shape, data };
        let (count, shape) = (constant.len(), &constant.shape);
        match count == len {
            true => Ok(constant),
            false => Err(format!("it has {count} values for the shape {shape:?}")),
        }
    }

    /// The constant, if its numbers are finite; what is but a bound may be infinite, which is none.
    ///
    /// # Errors
    /// Numbers that are not.
    pub fn checked(self, is_bound: bool) -> Result<Self, String> {
        let is_sound = |x: &f32| x.is_finite() || (is_bound && x.is_infinite());
        match &self.data {
            Data::Real(values) if !values.iter().all(is_sound) => {
                Err("it holds a number that is not finite".to_owned())
            }
            _ => Ok(self),
        }
    }

    /// A number.
    pub fn one(data: Data) -> Self {
        Self {
            shape: Vec::new(),
            data,
        }
    }

    /// Numbers along one axis.
    pub fn row(data: Data) -> Self {
        let mut row = Self::one(data);
        row.shape = vec![row.len()];
        row
    }

    /// The same as numbers of another of ONNX's types.
    pub fn cast(&self, to: i64) -> Result<Self, String> {
        let data = match (&self.data, to) {
            (Data::Real(values), 1 | 11) => Data::Real(values.clone()),
            (Data::Whole(values), 1 | 11) => Data::Real(values.iter().map(|x| *x as f32).collect()),
            (Data::Real(values), 9) => Data::Whole(values.iter().map(|x| i64::from(*x != 0.0)).collect()),
            (Data::Whole(values), 9) => Data::Whole(values.iter().map(|x| i64::from(*x != 0)).collect()),
            (Data::Real(values), 6 | 7) => Data::Whole(values.iter().map(|x| *x as i64).collect()),
            (Data::Whole(values), 6 | 7) => Data::Whole(values.clone()),
            _ => return Err(format!("a constant as numbers of {}", type_name(to))),
        };
        let shape = self.shape.clone();
        Ok(Self { shape, data })
    }

    /// Values by the constant that each is of and its place there.
    ///
    /// # Errors
    /// Constants of whole numbers beside real ones.
    pub fn picked(constants: &[&Self], places: &[(usize, usize)]) -> Result<Data, String> {
        fn pick<T: Copy>(all: &[&[T]], places: &[(usize, usize)]) -> Result<Vec<T>, String> {
            let of = |(i, place): &(usize, usize)| all.get(*i)?.get(*place).copied();
            let values: Option<Vec<T>> = places.iter().map(of).collect();
            values.ok_or_else(|| "a value is missing".to_owned())
        }
        if let Ok(whole) = constants.iter().map(|c| c.whole()).collect::<Result<Vec<_>, _>>() {
            return pick(&whole, places).map(Data::Whole);
        }
        let real = constants.iter().map(|c| c.real()).collect::<Result<Vec<_>, _>>()?;
        pick(&real, places).map(Data::Real)
    }

    /// How many values it has.
    pub fn len(&self) -> usize {
        match &self.data {
            Data::Real(values) => values.len(),
            Data::Whole(values) => values.len(),
        }
    }

    /// Weights.
    pub fn real(&self) -> Result<&[f32], String> {
        match &self.data {
            Data::Real(values) => Ok(values),
            Data::Whole(_) => Err("weights have to be float32".to_owned()),
        }
    }

    /// Indices.
    pub fn whole(&self) -> Result<&[i64], String> {
        match &self.data {
            Data::Whole(values) => Ok(values),
            Data::Real(_) => Err("an index or a shape has to be int64".to_owned()),
        }
    }

    /// Some of its values in another shape.
    pub fn moved(&self, shape: Vec<usize>, places: &[usize]) -> Result<Self, String> {
        let of_one: Vec<(usize, usize)> = places.iter().map(|place| (0, *place)).collect();
        Self::picked(&[self], &of_one).map(|data| Self { shape, data })
    }
}
