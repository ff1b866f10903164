//! Tables of TOML that extend each other, such as a file that sets values over a profile's.

/// Sets what `over` sets, table by table.
pub fn merge(table: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(over)) => merge(inner, over),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> toml::Table {
        text.parse().unwrap()
    }

    #[test]
    fn a_value_is_replaced_and_those_beside_it_stay() {
        let mut below = table("seed = 1\n[track]\nscales = 1\nquality = 0.1\n");
        merge(&mut below, table("[track]\nscales = 3\n[joints]\nchains = false\n"));
        let expected = "seed = 1\n[track]\nscales = 3\nquality = 0.1\n[joints]\nchains = false\n";
        assert_eq!(below, table(expected));
    }

    #[test]
    fn a_table_takes_the_place_of_a_value() {
        let mut below = table("lift = \"robust_mean\"\n");
        merge(&mut below, table("[lift.bilateral]\nsigma_s_px = 20.0\n"));
        assert_eq!(below, table("[lift.bilateral]\nsigma_s_px = 20.0\n"));
    }
}
