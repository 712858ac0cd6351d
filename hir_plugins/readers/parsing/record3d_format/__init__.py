"""The files of the app Record3D: a zip archive of photographs, depth maps and confidences."""
