//! Values of options: parsers that refuse a wrong value with the values that are allowed.
//!
//! The command line's parser adds the option's name and the value itself to the message.

use std::fmt::Display;
use std::str::FromStr;

pub(crate) use hullcast_batch::counted;

/// A parser of finite numbers from `least` to `most`.
pub(crate) fn number(least: f64, most: f64) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| {
        let value: Option<f64> = text.parse().ok();
        // NaN is outside every range.
        value
            .filter(|value| (least..=most).contains(value))
            .ok_or_else(|| format!("expected a number from {least} to {most}"))
    }
}

/// A parser of whole numbers from `least` to `most`.
pub(crate) fn count<T>(least: T, most: T) -> impl Fn(&str) -> Result<T, String> + Clone
where
    T: FromStr + PartialOrd + Display + Copy,
{
    move |text| {
        let value: Option<T> = text.parse().ok();
        value
            .filter(|value| (least..=most).contains(value))
            .ok_or_else(|| format!("expected a whole number from {least} to {most}"))
    }
}

/// A margin: a length, or infinity.
///
/// # Errors
/// It is negative or not a number.
pub(crate) fn margin(text: &str) -> Result<f64, String> {
    let value: Option<f64> = text.parse().ok();
    value.filter(|value| *value >= 0.0).ok_or_else(|| "expected a number of at least 0, or inf".into())
}

/// The end of a message that suggests the word of `known` that a misspelt `name` may mean; empty if no
/// word is similar.
pub(crate) fn did_you_mean<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    const NEAR: f64 = 0.7;
    let name = name.to_lowercase();
    let likeness = |other: &str| strsim::jaro_winkler(&name, &other.to_lowercase());
    let best = known.into_iter().map(|other| (likeness(other), other)).max_by(|a, b| a.0.total_cmp(&b.0));
    match best {
        Some((likeness, other)) if likeness >= NEAR => format!("; did you mean `{other}`?"),
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a suggestion that is not similar to the written word, and a similar word that is not
    /// suggested.
    #[test]
    fn only_near_names_are_suggested() {
        let known = ["listen", "store", "log", "max_connections"];
        assert_eq!(did_you_mean("listn", known), "; did you mean `listen`?");
        assert_eq!(did_you_mean("max-connections", known), "; did you mean `max_connections`?");
        assert_eq!(did_you_mean("quaternion", known), "");
        assert_eq!(did_you_mean("listn", []), "");
    }
}
