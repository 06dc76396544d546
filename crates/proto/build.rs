//! Compiles the wire contract without needing `protoc`.

use std::{
    env, fs,
    path::{Path, PathBuf},
};

use prost::Message as _;
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
