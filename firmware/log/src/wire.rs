//! The log's own messages as they are on disk: protobuf, so that any viewer decodes them by the schema in the file.
//!
//! Protobuf gives what a record needs: explicit little-endian numbers, additive versions, a decoder that answers
//! corrupted bytes with an error. Numbers that decide a replay are `optional`: a plain proto3 field is left out when it
//! equals 0.0, which would turn −0.0 into 0.0. In [`Status`], which is for plots only, a missing number is NaN, which
//! every plotting tool shows as a gap.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, OneofDescriptorProto,
};

/// Declares protobuf messages once: the Rust struct and the descriptor that goes into the file as schema.
/// A field reads `[type, label] name: RustType = number`, and `as Message` names the type of a message field.
macro_rules! messages {
    ($($(#[$doc:meta])* message $name:ident {
        $($(#[$field_doc:meta])* [$kind:ident $(, $label:ident)?] $field:ident: $rust:ty = $tag:tt $(as $target:ident)?;)*
    })*) => {
        $(
            $(#[$doc])*
            #[derive(Clone, PartialEq, prost::Message)]
            pub(crate) struct $name {
                $($(#[$field_doc])* #[prost($kind $(, $label)?, tag = $tag)] pub(crate) $field: $rust,)*
            }
        )*

        fn descriptors() -> Vec<DescriptorProto> {
            vec![$(describe(stringify!($name), &[
                $(Field {
                    name: stringify!($field),
                    kind: stringify!($kind),
                    label: concat!("" $(, stringify!($label))?),
                    target: concat!("" $(, stringify!($target))?),
                    tag: $tag,
                },)*
            ]),)*]
        }
    };
}

messages! {
    /// All inputs and outputs of one step, except the frame's pixels, which are in the depth channel.
    message Tick {
        /// Time of the step.
        [uint64] now_ns: u64 = 1;
        /// Timing inputs.
        [message, optional] timing: Option<Timing> = 2 as Timing;
        /// Header of the frame that was new in this step.
        [message, optional] frame: Option<Frame> = 3 as Frame;
        /// Datagrams received, in order.
        [message, repeated] received: Vec<Datagram> = 4 as Datagram;
        /// Datagrams sent, in order.
        [message, repeated] sent: Vec<Datagram> = 5 as Datagram;
        /// What the step decided.
        [message, optional] report: Option<Report> = 6 as Report;
        /// Records dropped before this one since start.
        [uint64] dropped_before: u64 = 7;
    }

    /// `StepTiming`.
    message Timing {
        [uint64] step: u64 = 1;
        [uint64] previous_execution_ns: u64 = 2;
        [uint64] wake_late_ns: u64 = 3;
        [uint64] slips: u64 = 4;
    }

    /// `FrameHeader`.
    message Frame {
        [uint64] stamp_ns: u64 = 1;
        [uint64] sequence: u64 = 2;
        [uint32] sensor_id: u32 = 3;
        [uint32] rows: u32 = 4;
        [uint32] cols: u32 = 5;
        [message, optional] position_ned_m: Option<Xyz> = 6 as Xyz;
        [message, optional] attitude: Option<Wxyz> = 7 as Wxyz;
        [uint32] reserved: u32 = 8;
        [fixed64] checksum: u64 = 9;
        [bytes] tag: Vec<u8> = 10;
    }

    /// One datagram and the link it belongs to.
    message Datagram {
        [uint32] link: u32 = 1;
        [bytes] data: Vec<u8> = 2;
    }

    /// `StepReport`.
    message Report {
        [uint64] now_ns: u64 = 1;
        [message, optional] timing: Option<Timing> = 2 as Timing;
        [uint32] state: u32 = 3;
        [uint32] reasons: u32 = 4;
        [message, optional] telemetry: Option<Telemetry> = 5 as Telemetry;
        [message, optional] goal_position_ned_m: Option<Xyz> = 6 as Xyz;
        [message, optional] goal_relative: Option<GoalRelative> = 7 as GoalRelative;
        [message, optional] action: Option<Action> = 8 as Action;
        [message, optional] setpoint: Option<Setpoint> = 9 as Setpoint;
        [uint64, optional] frame_sequence: Option<u64> = 10;
        [uint64, optional] frame_age_ns: Option<u64> = 11;
        [uint64] frames_refused: u64 = 12;
        [message, optional] judgement: Option<Judgement> = 13 as Judgement;
        [message, optional] alarm: Option<Alarm> = 14 as Alarm;
    }

    /// What the detector said of the actor's decision.
    message Judgement {
        /// 0 unknown, 1 clean, 2 attack.
        [uint32] verdict: u32 = 1;
        [float, optional] score: Option<f32> = 2;
        [float, optional] image: Option<f32> = 3;
        [float, optional] bearing: Option<f32> = 4;
        [float, optional] distance: Option<f32> = 5;
        [float, optional] base: Option<f32> = 6;
        /// 48 SHAP values of the actor's split point.
        [float, repeated] phi: Vec<f32> = 7;
    }

    /// The raised alarm.
    message Alarm {
        /// 0 attack, 1 no verdict, 2 collision course.
        [uint32] cause: u32 = 1;
        /// 0 ignored, 1 stop, 2 recovery.
        [uint32] response: u32 = 2;
    }

    /// `VehicleTelemetry`.
    message Telemetry {
        [message, optional] heartbeat: Option<Heartbeat> = 1 as Heartbeat;
        [message, optional] kinematics: Option<Kinematics> = 2 as Kinematics;
        [message, optional] attitude: Option<AttitudeSample> = 3 as AttitudeSample;
        /// 0 unknown, 1 on ground, 2 taking off, 3 in air, 4 landing.
        [uint32] landed: u32 = 4;
        [float, optional] battery_remaining: Option<f32> = 5;
    }

    /// The autopilot's last heartbeat.
    message Heartbeat {
        [uint64] at_ns: u64 = 1;
        [bool] armed: bool = 2;
        /// 0 unknown, 1 external, 2 hold, 3 take-off, 4 land, 5 return, 6 mission, 7 other.
        [uint32] mode: u32 = 3;
        [bool] failsafe: bool = 4;
    }

    /// Position and velocity.
    message Kinematics {
        [uint64] at_ns: u64 = 1;
        [message, optional] position_ned_m: Option<Xyz> = 2 as Xyz;
        [message, optional] velocity_ned_m_s: Option<Xyz> = 3 as Xyz;
    }

    /// Attitude and body rates.
    message AttitudeSample {
        [uint64] at_ns: u64 = 1;
        [message, optional] attitude: Option<Wxyz> = 2 as Wxyz;
        [message, optional] rates_frd_rad_s: Option<Xyz> = 3 as Xyz;
    }

    /// The goal as the pilot saw it.
    message GoalRelative {
        [float, optional] distance_m: Option<f32> = 1;
        [float, optional] bearing_rad: Option<f32> = 2;
    }

    /// The pilot's action.
    message Action {
        [float, optional] forward_m_s: Option<f32> = 1;
        [float, optional] yaw: Option<f32> = 2;
    }

    /// The setpoint sent.
    message Setpoint {
        [message, optional] velocity_heading_m_s: Option<Xyz> = 1 as Xyz;
        [float, optional] yaw_rate_rad_s: Option<f32> = 2;
    }

    /// Three components.
    message Xyz {
        [float, optional] x: Option<f32> = 1;
        [float, optional] y: Option<f32> = 2;
        [float, optional] z: Option<f32> = 3;
    }

    /// A quaternion, scalar first.
    message Wxyz {
        [float, optional] w: Option<f32> = 1;
        [float, optional] x: Option<f32> = 2;
        [float, optional] y: Option<f32> = 3;
        [float, optional] z: Option<f32> = 4;
    }

    /// One flat row per step, for plots and tables. Missing numbers are NaN.
    message Status {
        [uint64] step: u64 = 1;
        /// Name of the guidance state.
        [string] state: String = 2;
        /// Number of the guidance state, as in telemetry.
        [uint32] state_code: u32 = 3;
        /// Names of the reasons, comma-separated.
        [string] reasons: String = 4;
        /// The reasons as bits.
        [uint32] reason_bits: u32 = 5;
        [double] goal_distance_m: f64 = 6;
        [double] goal_bearing_deg: f64 = 7;
        [double] action_forward_m_s: f64 = 8;
        [double] action_yaw: f64 = 9;
        [double] setpoint_forward_m_s: f64 = 10;
        [double] setpoint_right_m_s: f64 = 11;
        [double] setpoint_down_m_s: f64 = 12;
        [double] setpoint_yaw_rate_deg_s: f64 = 13;
        [double] north_m: f64 = 14;
        [double] east_m: f64 = 15;
        [double] height_m: f64 = 16;
        /// Horizontal speed.
        [double] speed_m_s: f64 = 17;
        [double] climb_m_s: f64 = 18;
        [double] roll_deg: f64 = 19;
        [double] pitch_deg: f64 = 20;
        [double] heading_deg: f64 = 21;
        [double] yaw_rate_deg_s: f64 = 22;
        [double] battery_percent: f64 = 23;
        [bool] armed: bool = 24;
        /// Name of the vehicle's mode.
        [string] vehicle_mode: String = 25;
        /// Execution time of the previous tick.
        [double] step_time_ms: f64 = 26;
        [double] wake_late_ms: f64 = 27;
        [uint64] slips: u64 = 28;
        [double] frame_age_ms: f64 = 29;
        [double] telemetry_age_ms: f64 = 30;
        [uint64] frames_refused: u64 = 31;
        [uint32] received_datagrams: u32 = 32;
        [uint32] sent_datagrams: u32 = 33;
        /// Records that the recorder dropped since start.
        [uint64] records_dropped: u64 = 34;
        /// The detector's score, 0 to 1.
        [double] detector_score: f64 = 35;
        /// 0 unknown, 1 clean, 2 attack.
        [double] detector_verdict: f64 = 36;
        /// What frames, bearing and distance contributed to the actor's yaw output, in its units.
        [double] contribution_image: f64 = 37;
        [double] contribution_bearing: f64 = 38;
        [double] contribution_distance: f64 = 39;
        /// Cause of the alarm; empty when there is none.
        [string] alarm: String = 40;
        /// What is done about it: 0 ignored, 1 stop, 2 recovery.
        [double] alarm_response: f64 = 41;
    }
}

/// Package of the log's own messages.
const PACKAGE: &str = "vigil.log";

/// Full name of a message, as a schema's name in the file.
pub(crate) fn schema_name(message: &str) -> String {
    format!("{PACKAGE}.{message}")
}

/// The schema of all messages above: an encoded `FileDescriptorSet`.
pub(crate) fn file_descriptor_set() -> Vec<u8> {
    FileDescriptorSet {
        file: vec![FileDescriptorProto {
            name: Some("vigil/log.proto".to_owned()),
            package: Some(PACKAGE.to_owned()),
            message_type: descriptors(),
            syntax: Some("proto3".to_owned()),
            ..Default::default()
        }],
    }
    .encode_to_vec()
}

struct Field {
    name: &'static str,
    kind: &'static str,
    label: &'static str,
    target: &'static str,
    tag: i32,
}

fn describe(name: &str, fields: &[Field]) -> DescriptorProto {
    let mut message = DescriptorProto {
        name: Some(name.to_owned()),
        ..Default::default()
    };
    for field in fields {
        let mut described = FieldDescriptorProto {
            name: Some(field.name.to_owned()),
            number: Some(field.tag),
            ..Default::default()
        };
        described.set_type(match field.kind {
            "uint64" => Type::Uint64,
            "uint32" => Type::Uint32,
            "fixed64" => Type::Fixed64,
            "float" => Type::Float,
            "double" => Type::Double,
            "bool" => Type::Bool,
            "string" => Type::String,
            "bytes" => Type::Bytes,
            // The derive of the struct admits no other kind that is used above.
            _ => Type::Message,
        });
        described.set_label(if field.label == "repeated" {
            Label::Repeated
        } else {
            Label::Optional
        });
        if !field.target.is_empty() {
            described.type_name = Some(format!(".{PACKAGE}.{}", field.target));
        } else if field.label == "optional" {
            // proto3 expresses "present or absent" as a oneof of one field.
            described.proto3_optional = Some(true);
            described.oneof_index = i32::try_from(message.oneof_decl.len()).ok();
            message.oneof_decl.push(OneofDescriptorProto {
                name: Some(format!("_{}", field.name)),
                options: None,
            });
        }
        message.field.push(described);
    }
    message
}
