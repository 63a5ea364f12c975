"""A cluster of two machines, as Ray plays it on one: reached by its address, and one of them is lost."""

import pytest

from cluttergen_jax.cluster import Cluster, each_on
from cluttergen_jax.errors import ClutterGenError
from tests.helpers import clusters as work

pytest.importorskip("ray", reason="needs the extra ray")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_machine_that_is_lost_leaves_its_work_to_the_others():
    from ray.cluster_utils import Cluster as Machines

    machines = Machines(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        second = machines.add_node(num_cpus=1)
        results = each_on(Cluster(machines.address), work.slow_squares, range(60), "number")
        found, places = {}, set()
        for place, (square, node) in results:
            found[place] = square
            places.add(node)
            if second is not None and len(places) == 2:
                machines.remove_node(second, allow_graceful=False)
                second = None
        assert second is None
        assert found == {number: number * number for number in range(60)}
    finally:
        machines.shutdown()


def test_a_cluster_that_is_not_there_is_said():
    with pytest.raises(ClutterGenError, match=r"no Ray cluster answers at '127\.0\.0\.1:9'"):
        list(each_on(Cluster("127.0.0.1:9"), work.squares, range(3), "number"))
