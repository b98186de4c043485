"""The topics of the original framework, whose names and types never change."""

from biosensor_gateway.devices.registry import declaration, declaration_names


def test_contract_topics_have_the_originals_names_and_types() -> None:
    """The node publishes what the declarations say."""
    contract = {
        f"{name}/{stream.data_name}": stream.message_type.value.rpartition("/")[2]
        for name in declaration_names()
        for stream in declaration(name).streams
        if stream.contract
    }
    assert contract == {
        "empatica_e4/bvp": "Float32",
        "empatica_e4/gsr": "Float32",
        "empatica_e4/st": "Float32",
        "empatica_e4/hr": "Float32",
        "empatica_e4/ibi": "Float32",
        "empatica_e4/acc": "Float32MultiArray",
        "empatica_e4/bat": "Float32",
        "empatica_e4/tag": "Empty",
        "emotiv_insight/eeg": "Float32MultiArray",
        "emotiv_insight/pow": "Float32MultiArray",
        "emotiv_insight/met": "Float32MultiArray",
        "emotiv_insight/mot": "Float32MultiArray",
        "emotiv_insight/dev": "Float32MultiArray",
        "shimmer3_gsr/gsr": "Float32",
        "shimmer3_gsr/ppg": "Float32",
        "polar_h10/hr": "Float32",
        "vernier_respiration_belt/bpm": "Float32",
        "vernier_respiration_belt/force": "Float32",
        "zephyr/hr": "UInt8",
        "zephyr/hrv": "UInt16",
        "zephyr/br": "Float32",
    }
