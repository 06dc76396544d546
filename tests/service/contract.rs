//! The contract may grow, but everything in it stays as it is.

use std::collections::BTreeSet;

use prost::Message;
use prost_types::{DescriptorProto, EnumDescriptorProto, FileDescriptorSet};

/// Everything in a descriptor set that a client may rely on, one line per fact.
fn promises(bytes: &[u8]) -> BTreeSet<String> {
    let set = FileDescriptorSet::decode(bytes).unwrap();
    let mut lines = BTreeSet::new();
    for file in set.file.iter().filter(|file| file.package() == "hullcast.v1") {
        for message in &file.message_type {
            promise_message(message, "", &mut lines);
        }
        for values in &file.enum_type {
            promise_enum(values, &mut lines);
        }
        for service in &file.service {
            for method in &service.method {
                lines.insert(format!(
                    "{}.{}({} {}) {} {}",
                    service.name(),
                    method.name(),
                    method.client_streaming(),
                    method.input_type(),
                    method.server_streaming(),
                    method.output_type()
                ));
            }
        }
    }
    lines
}

fn promise_message(message: &DescriptorProto, outer: &str, lines: &mut BTreeSet<String>) {
    let name = format!("{outer}.{}", message.name());
    for field in &message.field {
        lines.insert(format!(
            "{name}.{} = {} {:?} {:?} {} optional {}",
            field.name(),
            field.number(),
            field.label(),
            field.r#type(),
            field.type_name(),
            field.proto3_optional()
        ));
    }
    // A number that was given up must not be reused for another field.
    for range in &message.reserved_range {
        lines.insert(format!("{name} reserves {} to {}", range.start(), range.end() - 1));
    }
    for nested in &message.nested_type {
        promise_message(nested, &name, lines);
    }
    for values in &message.enum_type {
        promise_enum(values, lines);
    }
}

fn promise_enum(values: &EnumDescriptorProto, lines: &mut BTreeSet<String>) {
    for value in &values.value {
        lines.insert(format!("{}.{} = {}", values.name(), value.name(), value.number()));
    }
}

const BASELINE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/proto/hullcast.v1.binpb");

/// Compares the contract with the committed baseline. Catches a field, value or method that is
/// gone, renumbered or of another type, which breaks clients. New parts must be added to the
/// baseline: HULLCAST_UPDATE_BASELINE=1 writes it.
#[test]
fn nothing_of_the_baseline_is_gone_or_changed() {
    let baseline = promises(&std::fs::read(BASELINE).unwrap());
    let current = promises(hullcast::proto::FILE_DESCRIPTOR_SET);
    assert!(baseline.len() > 100, "the baseline is too short: {}", baseline.len());
    let broken: Vec<_> = baseline.difference(&current).collect();
    assert!(broken.is_empty(), "{broken:#?}");
    if std::env::var_os("HULLCAST_UPDATE_BASELINE").is_some() {
        std::fs::write(BASELINE, hullcast::proto::FILE_DESCRIPTOR_SET).unwrap();
        return;
    }
    let new: Vec<_> = current.difference(&baseline).collect();
    assert!(new.is_empty(), "missing in the baseline (HULLCAST_UPDATE_BASELINE=1 adds it): {new:#?}");
}
