# Draws the imported asset.glb under asset.hdr from each camera of shots.json: godot3 --path FOLDER -s shots.gd
extends SceneTree

func _init():
	call_deferred("_draw")

func _draw():
	var file = File.new()
	file.open("res://shots.json", File.READ)
	var shots = JSON.parse(file.get_as_text()).result
	var image = Image.new()
	image.load("res://asset.hdr") # as it is; the importer would compress it
	var panorama = ImageTexture.new()
	panorama.create_from_image(image, Texture.FLAG_FILTER)
	var sky = PanoramaSky.new()
	sky.panorama = panorama
	sky.radiance_size = Sky.RADIANCE_SIZE_512
	var environment = Environment.new()
	environment.background_mode = Environment.BG_COLOR_SKY
	environment.background_color = Color(0, 0, 0)
	environment.background_sky = sky
	environment.ambient_light_sky_contribution = 1.0
	environment.tonemap_mode = Environment.TONE_MAPPER_LINEAR
	var view = Viewport.new()
	view.size = Vector2(shots[0].width, shots[0].height)
	view.own_world = true
	view.msaa = Viewport.MSAA_4X
	view.render_target_v_flip = true
	view.render_target_update_mode = Viewport.UPDATE_ALWAYS
	root.add_child(view)
	view.add_child(load("res://asset.glb").instance())
	var camera = Camera.new()
	camera.environment = environment
	view.add_child(camera)
	camera.current = true
	for index in range(len(shots)):
		var shot = shots[index]
		var c = shot.camera_to_world_columns
		camera.fov = shot.fov_y_deg
		camera.near = shot.near
		camera.far = shot.far
		camera.transform = Transform(Vector3(c[0], c[1], c[2]), Vector3(c[4], c[5], c[6]), Vector3(c[8], c[9], c[10]),
				Vector3(c[12], c[13], c[14]))
		for _frame in range(4): # the sky is prefiltered over several
			yield(self, "idle_frame")
		view.get_texture().get_data().save_png("res://%d.png" % index)
	quit()
