"""USD exports, read back by USD itself: poses, masses, colliders, units, and its own validators."""

import numpy as np
import pytest

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.scene.export import export_scenes
from tests.helpers.exports import CLOSE, dining_scene, matrix

pytest.importorskip("pxr", reason="needs the extra usd")

from pxr import Usd, UsdGeom, UsdPhysics, UsdShade, UsdValidation


@pytest.fixture(scope="module")
def scene():
    return dining_scene()


@pytest.fixture(scope="module")
def stage(scene, tmp_path_factory):
    # Opened where it was moved to: nothing may point to where it was made.
    folder = export_scenes([scene], tmp_path_factory.mktemp("usd") / "made", "usd")
    folder.rename(folder.with_name("moved"))
    return Usd.Stage.Open(str(folder.with_name("moved") / "scenes" / "000000.usda"))


def bodies_of(stage) -> dict:
    """The rigid bodies of a stage by display name of the placed prim."""
    prims = stage.GetPrimAtPath("/World/objects").GetChildren()
    return {prim.GetDisplayName(): prim for prim in prims}


def test_poses_and_masses_come_back(stage, scene):
    bodies = bodies_of(stage)
    assert set(bodies) == set(scene.names)
    cache = UsdGeom.XformCache()
    for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
        frame = np.array(cache.GetLocalToWorldTransform(bodies[name])).T
        np.testing.assert_allclose(frame, matrix(pose), atol=CLOSE)
        assert_mass(bodies[name], asset)


def assert_mass(prim, asset: ObjectAsset):
    """What USD computes of a body from all that is authored, colliders included, is the asset's own."""
    assert prim.HasAPI(UsdPhysics.RigidBodyAPI)
    mass = UsdPhysics.MassAPI(prim)
    assert mass.GetMassAttr().Get() == pytest.approx(asset.mass, rel=1e-6)
    np.testing.assert_allclose(mass.GetCenterOfMassAttr().Get(), asset.center_of_mass, atol=1e-7)
    axes = mass.GetPrincipalAxesAttr().Get()
    x, y, z = axes.GetImaginary()
    turn = matrix(np.array([0, 0, 0, axes.GetReal(), x, y, z]))[:3, :3]
    moments = np.diag(mass.GetDiagonalInertiaAttr().Get())
    np.testing.assert_allclose(turn @ moments @ turn.T, asset.inertia, rtol=1e-4, atol=1e-9)


def test_colliders_are_convex_hulls_with_friction(stage, scene):
    bodies = bodies_of(stage)
    for name, asset in zip(scene.names, scene.objects, strict=True):
        colliders = [p for p in Usd.PrimRange(bodies[name]) if p.HasAPI(UsdPhysics.CollisionAPI)]
        assert len(colliders) == len(asset.parts)
        for prim, part in zip(colliders, asset.parts, strict=True):
            assert UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() == "convexHull"
            assert UsdGeom.Imageable(prim).ComputePurpose() == "guide"
            points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get())
            np.testing.assert_allclose(points.min(0), part.vertices.min(0), atol=1e-6)
            np.testing.assert_allclose(points.max(0), part.vertices.max(0), atol=1e-6)
            material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
            physics = UsdPhysics.MaterialAPI(material.GetPrim())
            assert physics.GetStaticFrictionAttr().Get() == pytest.approx(scene.contact.friction[0])
    support = stage.GetPrimAtPath("/World/support")
    boxes = [p for p in Usd.PrimRange(support) if p.HasAPI(UsdPhysics.CollisionAPI)]
    assert len(boxes) == len(scene.support.boxes)
    assert not any(p.HasAPI(UsdPhysics.RigidBodyAPI) for p in Usd.PrimRange(support))


def test_usds_own_validators_find_nothing(stage):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert validators
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetMessage() for error in errors] == []
