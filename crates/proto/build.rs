//! Compiles the wire contract without needing `protoc`.

use std::{
    env, fs,
    path::{Path, PathBuf},
};

use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use tonic_prost_build::{FileDescriptorSet, manual};

const FILES: [&str; 3] =
    ["hullcast/v1/contacts.proto", "hullcast/v1/hulls.proto", "hullcast/v1/server.proto"];

fn main() {
    let contract = contract();
    println!("cargo:rerun-if-changed={contract}");
    let descriptors = protox::compile(FILES, [contract]).expect("the contract compiles");
    // Comments go into the generated code, but not into the descriptors that reflection sends.
    let mut bare = descriptors.clone();
    bare.file.iter_mut().for_each(|file| file.source_code_info = None);
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::write(out.join("hullcast.v1.binpb"), bare.encode_to_vec()).expect("OUT_DIR is writable");
    fs::write(out.join("columns.rs"), columns(&descriptors)).expect("OUT_DIR is writable");
    fs::write(out.join("methods.rs"), methods(&descriptors)).expect("OUT_DIR is writable");
    fs::write(out.join("tags.rs"), tags(&descriptors)).expect("OUT_DIR is writable");
    manual::Builder::new().build_client(false).compile(&servers(&descriptors));
    tonic_prost_build::configure()
        .codec_path("crate::Codec")
        .build_server(false)
        .compile_fds(descriptors)
        .expect("the contract generates");
}

/// The folder of the contract, relative to this package: the one of the repository, or in a published
/// package the copy that it contains.
fn contract() -> &'static str {
    let repository = "../../proto";
    if Path::new(repository).join(FILES[0]).is_file() { repository } else { "proto" }
}

/// The definitions of the services for the server, whose methods receive encoded requests.
fn servers(descriptors: &FileDescriptorSet) -> Vec<manual::Service> {
    let services = descriptors.file.iter().flat_map(|file| {
        file.service.iter().map(|service| {
            let builder = manual::Service::builder().name(service.name()).package(file.package());
            let methods = service.method.iter().map(|method| {
                let builder = manual::Method::builder()
                    .name(snake_case(method.name()))
                    .route_name(method.name())
                    .input_type(format!("crate::Encoded<{}>", rust_type(method.input_type())))
                    .output_type(rust_type(method.output_type()))
                    .codec_path("crate::ServerCodec");
                let builder = if method.client_streaming() { builder.client_streaming() } else { builder };
                let builder = if method.server_streaming() { builder.server_streaming() } else { builder };
                builder.build()
            });
            methods.fold(builder, |builder, method| builder.method(method)).build()
        })
    });
    services.collect()
}

/// The call of `columnar!` for every message that a method receives or sends, with its columns: the repeated
/// fields of type `double` or `fixed32`, in the order of their tags.
fn columns(descriptors: &FileDescriptorSet) -> String {
    let mut methods: Vec<_> = descriptors
        .file
        .iter()
        .flat_map(|file| &file.service)
        .flat_map(|service| &service.method)
        .flat_map(|method| [method.input_type(), method.output_type()])
        .collect();
    methods.sort_unstable();
    methods.dedup();
    let mut text = String::from("columnar! {\n");
    for file in &descriptors.file {
        for message in &file.message_type {
            if !methods.contains(&format!(".{}.{}", file.package(), message.name()).as_str()) {
                continue;
            }
            text += &format!("    {} {{\n", message.name());
            let mut fields: Vec<_> = message.field.iter().collect();
            fields.sort_unstable_by_key(|field| field.number());
            for field in fields {
                let kind = match (field.label(), field.r#type()) {
                    (Label::Repeated, Type::Double) => "Doubles",
                    (Label::Repeated, Type::Fixed32) => "Fixed32s",
                    _ => continue,
                };
                text += &format!("        {kind} {} = {};\n", field.name(), field.number());
            }
            text += "    }\n";
        }
    }
    text + "}\n"
}

/// A constant for every method, `QUERY_CONTACTS` for `QueryContacts`, with its path without the leading slash.
fn methods(descriptors: &FileDescriptorSet) -> String {
    let mut text = String::new();
    for file in &descriptors.file {
        for service in &file.service {
            for method in &service.method {
                let constant = snake_case(method.name()).to_uppercase();
                let name = format!("{}.{}/{}", file.package(), service.name(), method.name());
                text += &format!("pub const {constant}: &str = \"{name}\";\n");
            }
        }
    }
    text
}

/// A module for every message, `query_contacts_request` for `QueryContactsRequest`, with a constant for the
/// tag of every field: `HULL_IDS` for `hull_ids`.
fn tags(descriptors: &FileDescriptorSet) -> String {
    let mut text = String::new();
    for message in descriptors.file.iter().flat_map(|file| &file.message_type) {
        text += &format!("pub mod {} {{\n", snake_case(message.name()));
        for field in &message.field {
            let constant = field.name().to_uppercase();
            text += &format!("    pub const {constant}: u32 = {};\n", field.number());
        }
        text += "}\n";
    }
    text
}

/// Converts `.hullcast.v1.Name` to a path in the crate.
fn rust_type(name: &str) -> String {
    format!("crate::{}", name.rsplit('.').next().unwrap_or(name))
}

/// Converts `QueryContacts` to `query_contacts`.
fn snake_case(name: &str) -> String {
    let word = |(index, letter): (usize, char)| {
        let underscore = (index > 0 && letter.is_uppercase()).then_some('_');
        underscore.into_iter().chain(letter.to_lowercase())
    };
    name.chars().enumerate().flat_map(word).collect()
}
