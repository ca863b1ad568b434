//! DeepSHAP explanations and the verdict on them.
