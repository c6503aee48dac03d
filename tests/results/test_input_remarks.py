"""What readers put right or decided is said once, with the images that it is of."""

from dataclasses import replace

from networks import network, pair

from mgsgraph.results.soundness import reading_statements


def test_each_remark_is_said_once_with_its_images() -> None:
    net = network(pair())
    assert reading_statements(net.images) == []
    first, second, *others = net.images
    images = (replace(first, remarks=("one", "two")), replace(second, remarks=("two",)), *others)

    one, two = reading_statements(images)
    assert one.endswith(f"{first.name}: one.")
    assert two.endswith(f"{first.name}, {second.name}: two.")
