//! Writes the seeds of the target `decode` into a directory.

fn main() -> std::io::Result<()> {
    let directory = std::path::PathBuf::from(std::env::args_os().nth(1).expect("a directory"));
    for (name, method, message) in hullcast_fuzz::seeds::all() {
        std::fs::write(directory.join(name), [&[method], &message[..]].concat())?;
    }
    Ok(())
}
