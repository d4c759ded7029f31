"""The services of simulation_interfaces: on stubs of the same fields, and on the real package.

The stubs have the fields of version 2. The last test needs the package itself: it is skipped where
that is not installed.
"""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import Accel, Pose, Twist, Vector3  # noqa: E402  (needs rclpy)
from peer import Peer, running  # noqa: E402
from physics_scene import simulate  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from waiting import LIMIT_S  # noqa: E402

from lunar_rover_sim.base.errors import PhysicsError  # noqa: E402
from lunar_rover_sim.nodes.simulation_services import SimulationServices, topic_of  # noqa: E402
from lunar_rover_sim.rover.description import load_rover  # noqa: E402

OK, UNSUPPORTED, NOT_FOUND, INCORRECT, FAILED = 1, 0, 2, 3, 4
STOPPED, PLAYING, PAUSED, QUITTING, NO_WORLD = range(5)

MSG: Any = SimpleNamespace(
    Result=SimpleNamespace(
        RESULT_OK=OK, RESULT_FEATURE_UNSUPPORTED=UNSUPPORTED, RESULT_NOT_FOUND=NOT_FOUND,
        RESULT_INCORRECT_STATE=INCORRECT, RESULT_OPERATION_FAILED=FAILED),
    SimulationState=SimpleNamespace(
        STATE_STOPPED=STOPPED, STATE_PLAYING=PLAYING, STATE_PAUSED=PAUSED,
        STATE_QUITTING=QUITTING),
    SimulatorFeatures=SimpleNamespace(
        ENTITY_CATEGORIES=8, ENTITY_STATE_GETTING=10, ENTITY_STATE_SETTING=11,
        SIMULATION_RESET=20, SIMULATION_RESET_TIME=21, SIMULATION_RESET_STATE=22,
        SIMULATION_STATE_GETTING=24, SIMULATION_STATE_SETTING=25, SIMULATION_STATE_PAUSE=26,
        STEP_SIMULATION_SINGLE=31, STEP_SIMULATION_MULTIPLE=32, ENTITY_BOUNDS=5,
        ENTITY_BOUNDS_BOX=6, ENTITY_INFO_GETTING=12, STEP_SIMULATION_ACTION=33),
    EntityCategory=SimpleNamespace(CATEGORY_ROBOT=1),
    EntityState=lambda: entity_state(),
    Bounds=SimpleNamespace(TYPE_EMPTY=0, TYPE_BOX=1, TYPE_SPHERE=3))
SRV: Any = SimpleNamespace(
    GetSimulatorFeatures=None, StepSimulation=None, SpawnEntity=None, LoadWorld=None,
    SetSimulationState=SimpleNamespace(Response=SimpleNamespace(ALREADY_IN_TARGET_STATE=101)),
    SetEntityState=SimpleNamespace(Response=SimpleNamespace(INVALID_POSE=101)),
    ResetSimulation=SimpleNamespace(Request=SimpleNamespace(
        SCOPE_DEFAULT=0, SCOPE_TIME=1, SCOPE_STATE=2, SCOPE_SPAWNED=4, SCOPE_ALL=255)))


def entity_state(frame: str = '', z: float = 1.0) -> Any:
    """Return an EntityState: a pose at a height, at rest."""
    state = SimpleNamespace(header=Header(frame_id=frame), pose=Pose(), twist=Twist(),
                            acceleration=Accel())
    state.pose.position.z = z
    return state


def response(**fields: Any) -> Any:
    """Return an empty response."""
    return SimpleNamespace(result=SimpleNamespace(result=-1, error_message=''), **fields)


def filters(name: str = '', **given: Any) -> Any:
    """Return a request of GetEntities."""
    fields = {'categories': [], 'tags': SimpleNamespace(tags=[]),
              'bounds': SimpleNamespace(type=0, points=[]), **given}
    return SimpleNamespace(filters=SimpleNamespace(filter=name, **fields))


class FakeSimulator:
    """Remembers what it was asked for."""

    def __init__(self) -> None:
        self.is_paused = self.is_lockstep = False
        self.now_ns, self.world_frame = 1_500_000_000, 'odom'
        self.calls: list[Any] = []
        self.problem: str | None = None
        with simulate() as simulation:
            self._state = simulation.state

    def rover_state(self) -> Any:
        return self._state

    def pause(self, paused: bool) -> None:
        self.is_paused = paused

    def reset(self) -> None:
        self.calls.append('reset')

    def restart(self) -> None:
        self.calls.append('restart')

    def quit(self) -> None:
        self.calls.append('quit')

    def move(self, *where: Any) -> None:
        if where[0] is not None and where[0][2] < 0.0:
            raise PhysicsError('in the ground')
        self.calls.append(where)

    def step(self, count: int) -> str | None:
        self.calls.append(count)
        return self.problem


@pytest.fixture()
def simulator() -> FakeSimulator:
    """Give a simulator that runs in real time."""
    return FakeSimulator()


@pytest.fixture()
def services(simulator: FakeSimulator) -> SimulationServices:
    """Give the services on stubs."""
    return SimulationServices(simulator, MSG, SRV, load_rover(), 'worlds/a')


def test_states(simulator: FakeSimulator, services: SimulationServices) -> None:
    """Play, pause, stop and quit; stopping resets; who is there already is told so."""
    def set_state(wanted: int) -> int:
        request = SimpleNamespace(state=SimpleNamespace(state=wanted))
        return services.set_state(request, response()).result.result

    def state() -> int:
        return services.get_state(None, response(state=SimpleNamespace(state=-1))).state.state

    assert state() == PLAYING and set_state(PLAYING) == 101
    assert set_state(PAUSED) == OK and simulator.is_paused and state() == PAUSED
    assert set_state(STOPPED) == OK and simulator.calls == ['restart'] and state() == STOPPED
    assert set_state(PAUSED) == OK and state() == PAUSED
    assert set_state(STOPPED) == OK and set_state(PLAYING) == OK and state() == PLAYING
    assert set_state(NO_WORLD) == UNSUPPORTED
    assert set_state(QUITTING) == OK and simulator.calls[-1] == 'quit'


def test_steps(simulator: FakeSimulator, services: SimulationServices) -> None:
    """While paused only; what prevents them is told."""
    request = SimpleNamespace(steps=7)
    assert services.step(request, response()).result.result == FAILED
    simulator.is_paused = True
    assert services.step(request, response()).result.result == OK
    assert simulator.calls == [7]
    simulator.problem = 'meanwhile'
    told = services.step(request, response()).result
    assert (told.result, told.error_message) == (FAILED, 'meanwhile')


def test_resets(simulator: FakeSimulator, services: SimulationServices) -> None:
    """All resets time too, the state alone does not; in lockstep time must be paused."""
    def reset(scope: int) -> int:
        return services.reset(SimpleNamespace(scope=scope), response()).result.result

    assert [reset(scope) for scope in (0, 255, 3, 2)] == [OK] * 4
    assert simulator.calls == ['restart', 'restart', 'restart', 'reset']
    assert reset(1) == reset(4) == UNSUPPORTED
    simulator.is_lockstep = True
    assert reset(0) == INCORRECT
    simulator.is_paused = True
    assert reset(0) == OK


def test_entities(services: SimulationServices) -> None:
    """The rover is all there is; filters of other kinds are refused."""
    def found(request: Any) -> Any:
        answer = services.entities(request, response(entities=None))
        return answer.entities if answer.result.result == OK else answer.result.result

    def sphere(x: float, radius: float) -> Any:
        return SimpleNamespace(type=3, points=[Vector3(x=x), Vector3(x=radius)])

    def box(x0: float, x1: float) -> Any:
        return SimpleNamespace(type=1, points=[Vector3(x=x0, y=-1.0, z=-1.0),
                                               Vector3(x=x1, y=1.0, z=1.0)])

    def robot(category: int) -> Any:
        return [SimpleNamespace(category=category)]

    assert found(filters()) == found(filters('^lunar')) == ['lunar_rover']
    assert found(filters(categories=robot(1))) == ['lunar_rover']
    assert found(filters('moon')) == found(filters(categories=robot(2))) == []
    assert found(filters(bounds=sphere(1.0, 0.9))) == ['lunar_rover']
    assert found(filters(bounds=sphere(2.0, 0.9))) == []
    assert found(filters(bounds=box(0.1, 5.0))) == found(filters(bounds=box(5.0, 0.1))) \
        == ['lunar_rover']
    assert found(filters(bounds=box(0.3, 5.0))) == []
    assert found(filters(bounds=SimpleNamespace(type=1, points=[]))) == FAILED
    assert found(filters(bounds=SimpleNamespace(type=2, points=[]))) == UNSUPPORTED
    assert found(filters(tags=SimpleNamespace(tags=['a']))) == UNSUPPORTED
    assert found(filters('(')) == FAILED


def test_states_of_all_entities(services: SimulationServices) -> None:
    """As GetEntities, with a state for each."""
    answer = services.entities_states(filters(), response(entities=[], states=None))
    assert answer.result.result == OK and answer.entities == ['lunar_rover']
    assert [state.header.frame_id for state in answer.states] == ['odom']
    answer = services.entities_states(filters('('), response(entities=[], states=None))
    assert answer.result.result == FAILED and answer.states == []


def test_what_the_entity_is(services: SimulationServices) -> None:
    """A robot, in a box that its legs reach the lower corner of; nothing else is known."""
    def ask(callback: Any, entity: str = 'lunar_rover', **fields: Any) -> Any:
        return callback(SimpleNamespace(entity=entity), response(**fields))

    info = SimpleNamespace(category=SimpleNamespace(category=0), description='')
    assert ask(services.entity_info, info=info).info.category.category == 1
    bounds = SimpleNamespace(type=0, points=[])
    upper, lower = ask(services.entity_bounds, bounds=bounds).bounds.points
    rover = load_rover()
    assert bounds.type == 1
    assert -lower.z == pytest.approx(rover.standing_height_m)
    assert upper.z == pytest.approx(rover.stereo.position_m[2])
    assert upper.y == -lower.y > rover.legs.axle_positions_m()[0][1]
    assert ask(services.entity_info, 'rock').result.result == NOT_FOUND
    assert ask(services.entity_bounds, 'rock').result.result == NOT_FOUND


@pytest.mark.parametrize('field', ['world_resource', 'level_resource'])
def test_the_world(field: str, services: SimulationServices) -> None:
    """Its folder, in the field that versions 2.1 and 2.0 have for it."""
    resource = SimpleNamespace(uri='')
    world = services.current_world(None, response(
        world=SimpleNamespace(name='', **{field: resource}))).world
    assert world.name == 'a'
    assert resource.uri.startswith('file:///') and resource.uri.endswith('/worlds/a')


def test_services_without_sense_are_refused_by_name(services: SimulationServices) -> None:
    """Every service of the package answers; StepSimulation has a thread of its own."""
    callbacks = services.callbacks()
    assert callbacks.keys() == {'GetSimulatorFeatures', 'SetSimulationState', 'SetEntityState',
                                'ResetSimulation', 'SpawnEntity', 'LoadWorld'}
    assert callbacks['SetEntityState'] == services.set_entity
    told = callbacks['SpawnEntity'](None, response()).result
    assert told.result == UNSUPPORTED and told.error_message.startswith('spawn_entity: is not ')
    assert topic_of('GetEntitiesStates') == 'get_entities_states'


def test_features_are_those_that_the_version_knows(services: SimulationServices) -> None:
    """GetCurrentWorld is of version 2, whose feature these stubs lack."""
    features = services.features(None, response(features=SimpleNamespace())).features.features
    assert {5, 6, 12, 31, 33} <= set(features) and 44 not in features


class FakeGoal:
    """A goal of SimulateSteps that remembers what it is told."""

    def __init__(self, steps: int) -> None:
        self.request = SimpleNamespace(steps=steps)
        self.told: list[Any] = []

    def publish_feedback(self, feedback: Any) -> None:
        self.told.append((feedback.completed_steps, feedback.remaining_steps))

    def succeed(self) -> None:
        self.told.append('succeeded')

    def abort(self) -> None:
        self.told.append('aborted')


def test_steps_of_the_action(simulator: FakeSimulator, services: SimulationServices) -> None:
    """One by one with feedback; while time runs, and when something prevents a step, none."""
    kind = SimpleNamespace(Result=response, Feedback=SimpleNamespace)

    def simulate(steps: int) -> tuple[int, list[Any]]:
        goal = FakeGoal(steps)
        return services.simulate(goal, kind).result.result, goal.told

    assert simulate(2) == (FAILED, ['aborted'])
    simulator.is_paused = True
    assert simulate(2) == (OK, [(1, 1), (2, 0), 'succeeded'])
    assert simulator.calls == [1, 1]
    simulator.problem = 'meanwhile'
    assert simulate(2) == (FAILED, ['aborted'])


def test_the_state_of_the_entity(simulator: FakeSimulator, services: SimulationServices) -> None:
    """Read with its time, set in odom; nonsense, and lockstep under way, is refused."""
    def answer(state: Any, entity: str = 'lunar_rover', **flags: bool) -> Any:
        request = SimpleNamespace(entity=entity, state=state, **flags)
        return services.set_entity(request, response()).result

    def set_state(state: Any, entity: str = 'lunar_rover', **flags: bool) -> int:
        return answer(state, entity, **flags).result

    read = services.get_entity(SimpleNamespace(entity='lunar_rover'),
                               response(state=entity_state()))
    assert read.result.result == OK and read.state.header.frame_id == 'odom'
    assert (read.state.header.stamp.sec, read.state.header.stamp.nanosec) == (1, 500_000_000)
    assert read.state.pose.position.z == simulator.rover_state().position_m[2]
    assert services.get_entity(SimpleNamespace(entity='rock'),
                               response()).result.result == NOT_FOUND
    assert set_state(entity_state()) == OK      # Jazzy: no flags
    position, wxyz, linear, angular = simulator.calls[-1]
    assert np.allclose(position, [0, 0, 1]) and np.allclose(wxyz, [1, 0, 0, 0])
    assert np.allclose([linear, angular], 0.0)
    assert set_state(entity_state(), set_pose=False, set_twist=True) == OK
    assert simulator.calls[-1][:2] == (None, None)
    # Both flags of version 2 are false where a request leaves them out.
    count = len(simulator.calls)
    left_out = answer(entity_state(z=-1.0), set_pose=False, set_twist=False)
    assert left_out.result == OK and len(simulator.calls) == count
    assert left_out.error_message == 'nothing is set: set_pose and set_twist are false'
    assert set_state(entity_state(z=-1.0)) == 101
    assert set_state(entity_state('base_link')) == FAILED
    assert set_state(entity_state(), 'rock') == NOT_FOUND
    simulator.is_lockstep = True
    assert set_state(entity_state()) == INCORRECT


@pytest.mark.ros
@pytest.mark.stacks
def test_the_real_package(peer: Peer, world_folder: Path) -> None:
    """All services over DDS: pause, steps at the pace of real time, a jump, a reset."""
    srv = pytest.importorskip('simulation_interfaces.srv')
    action = pytest.importorskip('simulation_interfaces.action')
    msg = pytest.importorskip('simulation_interfaces.msg')

    def call(name: str, **fields: Any) -> Any:
        kind = getattr(srv, name)
        return peer.call(kind, f'physics_node/{topic_of(name)}', kind.Request(**fields))

    def seconds() -> float:
        stamp = call('GetEntityState', entity='lunar_rover').state.header.stamp
        return stamp.sec + stamp.nanosec * 1e-9

    with running('physics_node', '-p', f'world:={world_folder}'):
        features = msg.SimulatorFeatures
        assert features.STEP_SIMULATION_MULTIPLE in call('GetSimulatorFeatures').features.features
        assert call('StepSimulation', steps=1).result.result == FAILED
        paused = msg.SimulationState(state=PAUSED)
        assert call('SetSimulationState', state=paused).result.result == OK
        assert call('GetSimulationState').state.state == PAUSED
        before = seconds()
        assert call('StepSimulation', steps=40).result.result == OK
        assert seconds() == pytest.approx(before + 0.2, abs=1e-9)
        told: list[int] = []
        client = ActionClient(peer.node, action.SimulateSteps, 'physics_node/simulate_steps')
        assert client.wait_for_server(LIMIT_S)
        accepted = client.send_goal_async(
            action.SimulateSteps.Goal(steps=3),
            lambda message: told.append(message.feedback.completed_steps))
        peer.spin_until(accepted.done)
        result = accepted.result().get_result_async()
        peer.spin_until(lambda: result.done() and len(told) == 3)
        assert result.result().result.result.result == OK and told == [1, 2, 3]
        client.destroy()
        assert call('GetEntities').entities == ['lunar_rover']
        assert len(call('GetEntitiesStates').states) == 1
        assert call('GetEntityBounds', entity='lunar_rover').bounds.type == msg.Bounds.TYPE_BOX
        for name in ('SpawnEntity', 'DeleteEntity', 'GetSpawnables'):
            assert call(name).result.result == UNSUPPORTED
        if hasattr(srv, 'GetCurrentWorld'):
            assert call('GetCurrentWorld').world.world_resource.uri == world_folder.as_uri()
        state = call('GetEntityState', entity='lunar_rover').state
        state.pose.position.x += 1.0
        state.pose.position.z += 0.5
        chosen = {name: True for name in ('set_pose', 'set_twist')      # of version 2
                  if hasattr(srv.SetEntityState.Request(), name)}
        assert call('SetEntityState', entity='lunar_rover', state=state,
                    **chosen).result.result == OK
        moved = call('GetEntityState', entity='lunar_rover').state
        assert moved.pose.position.x == pytest.approx(state.pose.position.x)
        assert call('ResetSimulation').result.result == OK
        assert seconds() == 0.0
        assert abs(call('GetEntityState', entity='lunar_rover').state.pose.position.x) < 0.1
