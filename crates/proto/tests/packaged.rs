//! The copy of the contract that a published package contains.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

/// The files of a version of the contract in this folder, by name.
fn contract(folder: &str) -> BTreeMap<PathBuf, String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder).join("hullcast/v1");
    let files = fs::read_dir(&folder).unwrap().map(|file| file.unwrap().path());
    files.map(|path| (path.file_name().unwrap().into(), fs::read_to_string(&path).unwrap())).collect()
}

/// Catches a package whose copy of the contract differs from that of the repository, from which everything
/// in the repository is built.
#[test]
fn the_packaged_contract_is_that_of_the_repository() {
    let repository = contract("../../proto");
    assert_eq!(contract("proto"), repository);
    assert_eq!(repository.len(), 3);
}
