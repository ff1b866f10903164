//! Numbers as a person reads them: degrees and centimetres instead of radians and metres, with as
//! many digits as they are worth.

use linkage_skill::object::JointKind;

/// An angle: `72°`, `7.5°`, `0.2°`.
pub fn angle(rad: f64) -> String {
    let deg = rad.to_degrees();
    format!("{}°", digits(deg, if deg.abs() < 9.95 { 1 } else { 0 }))
}

/// A length: `1.25 m`, `32 cm`, `6.4 cm`, `3 mm`.
pub fn length(m: f64) -> String {
    match m.abs() {
        x if x >= 0.995 => format!("{} m", digits(m, 2)),
        x if x >= 0.0995 => format!("{} cm", digits(100.0 * m, 0)),
        x if x >= 0.00995 => format!("{} cm", digits(100.0 * m, 1)),
        x if x >= 0.00095 || x == 0.0 => format!("{} mm", digits(1000.0 * m, 0)),
        _ => format!("{} mm", digits(1000.0 * m, 1)),
    }
}

/// A configuration of a joint.
pub fn amount(kind: JointKind, q: f64) -> String {
    if turns(kind) { angle(q) } else { length(q) }
}

/// True for joints whose configuration is an angle.
pub fn turns(kind: JointKind) -> bool {
    kind.unit() == "rad"
}

/// A probability: `97 %`, `> 99 %`, `< 1 %`.
pub fn probability(p: f64) -> String {
    match p {
        p if p > 0.99 => "> 99 %".to_owned(),
        p if p < 0.01 => "< 1 %".to_owned(),
        p => format!("{:.0} %", 100.0 * p),
    }
}

/// A number with this many decimals; a minus as it is printed, and none before zero.
fn digits(x: f64, decimals: usize) -> String {
    let text = format!("{x:.decimals$}");
    let zero = text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.');
    if zero { text.trim_start_matches('-').to_owned() } else { text.replace('-', "−") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_digits_that_they_are_worth() {
        let rad = |deg: f64| f64::to_radians(deg);
        assert_eq!([72.3, 7.46, -0.01].map(|d| angle(rad(d))), ["72°", "7.5°", "0.0°"]);
        assert_eq!(angle(rad(-12.4)), "−12°");
        let lengths = [1.25, 0.321, 0.064, 0.0032, 0.0, 0.0004];
        let said = ["1.25 m", "32 cm", "6.4 cm", "3 mm", "0 mm", "0.4 mm"];
        assert_eq!(lengths.map(length), said);
        assert_eq!([0.999, 0.973, 0.002].map(probability), ["> 99 %", "97 %", "< 1 %"]);
        assert_eq!(amount(JointKind::Prismatic, 0.3), "30 cm");
        assert_eq!(amount(JointKind::Helical, rad(90.0)), "90°");
    }
}
