//! The part of ONNX's protobuf messages that a network of dense, convolutional and recurrent layers needs; numbers as in
//! onnx.proto of ONNX 1.18 (<https://github.com/onnx/onnx/blob/v1.18.0/onnx/onnx.proto>). What is not here is skipped.

use prost::Message;

/// Messages with their fields, each with its place in the file.
macro_rules! messages {
    ($($(#[$doc:meta])* $name:ident { $($(#[$about:meta])* $field:ident: $type:ty = ($($place:tt)+),)+ })+) => {$(
        $(#[$doc])*
        #[derive(Clone, PartialEq, Message)]
        pub struct $name {
            $($(#[$about])* #[prost($($place)+)] pub $field: $type,)+
        }
    )+};
}

messages! {
    /// A file.
    Model {
        ir_version: i64 = (int64, tag = "1"),
        producer_name: String = (string, tag = "2"),
        producer_version: String = (string, tag = "3"),
        graph: Option<Graph> = (message, optional, tag = "7"),
        opset_import: Vec<OperatorSet> = (message, repeated, tag = "8"),
        metadata_props: Vec<Entry> = (message, repeated, tag = "14"),
    }
    /// Something to know about a file.
    Entry {
        key: String = (string, tag = "1"),
        value: String = (string, tag = "2"),
    }
    /// A version of a set of operators.
    OperatorSet {
        domain: String = (string, tag = "1"),
        version: i64 = (int64, tag = "2"),
    }
    /// Nodes in the order of computation, and constants.
    Graph {
        node: Vec<Node> = (message, repeated, tag = "1"),
        name: String = (string, tag = "2"),
        initializer: Vec<Tensor> = (message, repeated, tag = "5"),
        input: Vec<ValueInfo> = (message, repeated, tag = "11"),
        output: Vec<ValueInfo> = (message, repeated, tag = "12"),
    }
    /// An operator.
    Node {
        input: Vec<String> = (string, repeated, tag = "1"),
        output: Vec<String> = (string, repeated, tag = "2"),
        name: String = (string, tag = "3"),
        op_type: String = (string, tag = "4"),
        attribute: Vec<Attribute> = (message, repeated, tag = "5"),
        domain: String = (string, tag = "7"),
    }
    /// A node's setting.
    Attribute {
        name: String = (string, tag = "1"),
        f: f32 = (float, tag = "2"),
        i: i64 = (int64, tag = "3"),
        s: Vec<u8> = (bytes = "vec", tag = "4"),
        t: Option<Tensor> = (message, optional, tag = "5"),
        floats: Vec<f32> = (float, repeated, tag = "7"),
        ints: Vec<i64> = (int64, repeated, tag = "8"),
        strings: Vec<Vec<u8>> = (bytes = "vec", repeated, tag = "9"),
        /// Which of the others counts, in the numbers of `AttributeProto.AttributeType`.
        r#type: i32 = (int32, tag = "20"),
    }
    /// A constant.
    Tensor {
        dims: Vec<i64> = (int64, repeated, tag = "1"),
        data_type: i32 = (int32, tag = "2"),
        float_data: Vec<f32> = (float, repeated, tag = "4"),
        int32_data: Vec<i32> = (int32, repeated, tag = "5"),
        int64_data: Vec<i64> = (int64, repeated, tag = "7"),
        name: String = (string, tag = "8"),
        raw_data: Vec<u8> = (bytes = "vec", tag = "9"),
        double_data: Vec<f64> = (double, repeated, tag = "10"),
        /// Where in which file the data is, if it is in another.
        external_data: Vec<Entry> = (message, repeated, tag = "13"),
        /// 1: the data is in another file.
        data_location: i32 = (int32, tag = "14"),
    }
    /// An input or output.
    ValueInfo {
        name: String = (string, tag = "1"),
        r#type: Option<Type> = (message, optional, tag = "2"),
    }
    /// Its type, if it is a tensor.
    Type {
        tensor_type: Option<TensorType> = (message, optional, tag = "1"),
    }
    /// Of a tensor.
    TensorType {
        elem_type: i32 = (int32, tag = "1"),
        shape: Option<Shape> = (message, optional, tag = "2"),
    }
    /// Its sizes.
    Shape {
        dim: Vec<Dim> = (message, repeated, tag = "1"),
    }
    /// A size: a number, or the name of one that is not known.
    Dim {
        dim_value: i64 = (int64, tag = "1"),
        dim_param: String = (string, tag = "2"),
    }
}
