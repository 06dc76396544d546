//! Compiles the wire contract in `proto/` without needing `protoc`.

fn main() {
    #[cfg(feature = "server")]
    contract::compile();
}

#[cfg(feature = "server")]
mod contract {
    use std::{env, fs, path::PathBuf};

    use prost::Message as _;

    const FILES: [&str; 3] =
        ["hullcast/v1/contacts.proto", "hullcast/v1/hulls.proto", "hullcast/v1/server.proto"];

    pub(super) fn compile() {
        println!("cargo:rerun-if-changed=proto");
        let descriptors = protox::compile(FILES, ["proto"]).expect("the contract compiles");
        // The comments are for the generated code, not for what reflection sends.
        let mut bare = descriptors.clone();
        bare.file.iter_mut().for_each(|file| file.source_code_info = None);
        let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
        fs::write(out.join("hullcast.v1.binpb"), bare.encode_to_vec()).expect("OUT_DIR is writable");
        tonic_prost_build::configure()
            .codec_path("crate::proto::Codec")
            .compile_fds(descriptors)
            .expect("the contract generates");
    }
}
