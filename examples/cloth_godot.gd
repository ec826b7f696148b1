# SPDX-License-Identifier: MIT
# A cloth of bodies that Godot's physics joins by pins, hung by two corners. Prints its poses, or its mesh: see cloth_godot.sh
extends SceneTree

const SIDE = 16
const POSES = 90
var bodies = []
var poses = 0
var ticks = 0

func number(x, z):
	return z * SIDE + x

func _init():
	if "mesh" in OS.get_cmdline_args():
		for i in SIDE * SIDE:
			print("v ", i % SIDE * 0.1, " 0 ", i / SIDE * 0.1)
		for z in SIDE - 1:
			for x in SIDE - 1:
				print("f %d %d %d %d" % [number(x, z) + 1, number(x, z + 1) + 1, number(x + 1, z + 1) + 1, number(x + 1, z) + 1])
		return quit()
	Engine.iterations_per_second = 240
	for i in SIDE * SIDE:
		var body = RigidBody.new()
		if i == number(0, 0) or i == number(SIDE - 1, 0):
			body.mode = RigidBody.MODE_STATIC
		var shape = CollisionShape.new()
		shape.shape = SphereShape.new()
		shape.shape.radius = 0.04
		body.add_child(shape)
		body.linear_damp = 0.4
		body.collision_layer = 0
		body.collision_mask = 0
		body.translation = Vector3(i % SIDE * 0.1, 0, i / SIDE * 0.1)
		root.add_child(body)
		bodies.append(body)
	for z in SIDE:
		for x in SIDE:
			for other in [[x + 1, z], [x, z + 1]]:
				if other[0] < SIDE and other[1] < SIDE:
					pin(bodies[number(x, z)], bodies[number(other[0], other[1])])

func pin(a, b):
	var joint = PinJoint.new()
	joint.translation = (a.translation + b.translation) / 2
	root.add_child(joint)
	joint.set_node_a(a.get_path())
	joint.set_node_b(b.get_path())

func _iteration(_delta):
	ticks += 1
	if bodies and ticks % 8 == 0:
		var line = PoolStringArray()
		for body in bodies:
			line.append("%f %f %f" % [body.translation.x, body.translation.y, body.translation.z])
		print("pose ", line.join(" "))
		poses += 1
	if poses == POSES:
		quit()
