//! Puts what another program printed into docs/performance.md: `section NAME < text`.

use std::error::Error;
use std::io::Read;

use hullcast_benches::report::replace_section;

fn main() -> Result<(), Box<dyn Error>> {
    let name = std::env::args().nth(1).ok_or("section NAME")?;
    let mut text = String::new();
    std::io::stdin().read_to_string(&mut text)?;
    replace_section(&name, &format!("```\n{}\n```", text.trim_end()))?;
    Ok(())
}
