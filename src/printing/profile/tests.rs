use super::*;

#[test]
fn every_built_in_profile_is_valid_and_cites_known_sources() {
    let file: BuiltIn = serde_json::from_str(BUILT_IN).expect("valid profiles");
    let mut profiles = file.profiles;
    assert_eq!(profiles.len(), Profile::built_in().len());
    for profile in &mut profiles {
        let name = profile.name.clone();
        for list in profile.source_lists() {
            assert!(list.iter().all(|key| file.sources.contains_key(key)), "{name}: {list:?}");
        }
        assert_eq!(Profile::named(&name).map(|found| &found.name), Some(&name));
        assert!(profile.supported_wall_mm.minimum <= profile.supported_wall_mm.limit, "{name}");
        assert!(profile.supported_wall_mm.limit <= profile.free_wall_mm.limit, "{name}");
    }
}

#[test]
fn sourced_limits_name_a_source_and_others_name_none() {
    for profile in Profile::built_in() {
        for limit in [&profile.supported_wall_mm, &profile.free_wall_mm, &profile.pin_mm, &profile.gap_mm] {
            assert_eq!(limit.basis == Basis::Sourced, !limit.sources.is_empty(), "{}", profile.name);
        }
    }
}

#[test]
fn a_name_is_found_in_any_spelling_and_by_its_aliases() {
    for name in ["sls-pa12", "SLS PA12", "sls_pa12", "sls"] {
        assert_eq!(Profile::named(name).map(|profile| profile.name.as_str()), Some("sls-pa12"), "{name}");
    }
    assert_eq!(Profile::named("fdm_0.25").map(|profile| profile.name.as_str()), Some("fdm-0.25"));
    let error = Profile::resolve("sls-pa13", None).expect_err("unknown").to_string();
    assert!(error.contains("`sls-pa13`") && error.contains("sls-pa12"), "{error}");
}

#[test]
fn a_request_replaces_single_limits_and_keeps_the_others() {
    let limits = ProcessLimits { free_wall_mm: Some(1.4), escape_hole_count: Some(0), ..ProcessLimits::default() };
    let profile = Profile::resolve("sls", Some(&limits)).expect("a profile");
    assert_eq!((profile.free_wall_mm.limit, profile.free_wall_mm.basis), (1.4, Basis::Requested));
    assert_eq!(profile.supported_wall_mm, Profile::named("sls").expect("built in").supported_wall_mm);
    assert_eq!(profile.escape_holes, None);
    assert_eq!(profile.material_density, Profile::named("sls").expect("built in").material_density);
    let limits = ProcessLimits { based_on: Some("tpu".to_owned()), ..ProcessLimits::default() };
    let profile = Profile::resolve("our-tpu", Some(&limits)).expect("a profile");
    assert_eq!((profile.name.as_str(), profile.free_wall_mm.limit), ("our-tpu", 1.5));
    let invalid = ProcessLimits { gap_mm: Some(f64::NAN), ..ProcessLimits::default() };
    assert_eq!(Profile::resolve("sls", Some(&invalid)), Err(ProfileError::Limit { limit: "gap_mm" }));
}
