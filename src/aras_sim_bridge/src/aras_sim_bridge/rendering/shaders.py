"""GLSL of the opengl renderer."""

MESH_VERTEX = """
#version 330
// Pixel (u, v) of the picture is drawn at (u, v) of the framebuffer, so the rows need no turning.
uniform vec2 depth_range;  // (far + near) / (far - near), 2 far near / (far - near)
in vec3 position;
in vec3 normal;
in vec4 rgba;
in vec4 row0;              // face_T_link, one row each
in vec4 row1;
in vec4 row2;
in vec4 projection;        // see faces.Faces
in vec4 placement;
in vec3 sun;               // unit vector towards it, link frame
#ifdef MEASURE
in float label;
out float v_depth;
flat out float v_label;
#endif
uniform vec2 light;        // ambient, diffuse
#ifdef TILED
uniform vec2 lattice;
#endif
#ifdef CUT
uniform vec4 backdrop;     // plane n, d in the face frame; nothing behind it is drawn
#endif
out float v_light;         // shading is smooth between vertices
flat out vec4 v_rgba;
#ifdef TEXTURED
in vec3 uv;                // the third is the layer, below 0 for none
out vec2 v_uv;
flat out float v_layer;
#endif
void main() {
    vec4 p = vec4(position, 1.0);
    vec3 q = vec3(dot(row0, p), dot(row1, p), dot(row2, p));
    v_light = light.x + light.y * max(dot(normal, sun), 0.0);
    v_rgba = rgba;
#ifdef CUT
    gl_ClipDistance[4] = dot(backdrop.xyz, q) - backdrop.w;
#endif
    vec2 xy = projection.xz * q.xy + projection.yw * q.z;
#ifdef TILED
    // Sheared into refinement's lattice: x = 1 / (factor + 1), y = x / TILE, or 0 for none.
    xy = (1.0 - lattice.x) * xy + lattice.x * xy.yx - lattice.y * q.z;
    gl_ClipDistance[0] = q.z + xy.x;
    gl_ClipDistance[1] = q.z - xy.x;
    gl_ClipDistance[2] = q.z + xy.y;
    gl_ClipDistance[3] = q.z - xy.y;
#endif
#ifdef TEXTURED
    v_uv = uv.xy;
    v_layer = uv.z;
#endif
#ifdef MEASURE
    v_depth = q.z;
    v_label = label;
#endif
    gl_Position = vec4(placement.xz * xy + placement.yw * q.z,
                       depth_range.x * q.z - depth_range.y, q.z);
}
"""

MESH_FRAGMENT = """
#version 330
in float v_light;
flat in vec4 v_rgba;
#ifdef TEXTURED
uniform sampler2DArray textures;
in vec2 v_uv;
flat in float v_layer;
#endif
out vec4 colour;
void main() {
    vec4 albedo = v_rgba;
#ifdef TEXTURED
    vec4 texel = texture(textures, vec3(v_uv, max(v_layer, 0.0)));
    albedo *= v_layer < 0.0 ? vec4(1.0) : texel;
#endif
    colour = vec4(albedo.rgb * v_light, albedo.a);
}
"""


# Depth along the face's axis, and the row of the link plus one.
MEASURE_FRAGMENT = """
#version 330
in float v_depth;
flat in float v_label;
out vec2 measured;
void main() { measured = vec2(v_depth, v_label); }
"""


def defined(source: str, *names: str) -> str:
    """Shader source with preprocessor names switched on."""
    head, body = source.strip().split("\n", 1)
    return "\n".join([head, *(f"#define {name}" for name in names), body])
