"""GLSL of the opengl renderer."""

MESH_VERTEX = """
#version 330
// Pixel (u, v) of the picture is drawn at (u, v) of the framebuffer, so the rows need no turning.
uniform vec4 projection;   // 2 fx / w, (2 cx + 1) / w - 1, 2 fy / h, (2 cy + 1) / h - 1
uniform vec2 depth_range;  // (far + near) / (far - near), 2 far near / (far - near)
in vec3 position;
in vec3 normal;
in vec4 rgba;
in vec4 row0;              // optical_T_link, one row each
in vec4 row1;
in vec4 row2;
out vec3 v_normal;
flat out vec4 v_rgba;
void main() {
    vec4 p = vec4(position, 1.0);
    vec3 q = vec3(dot(row0, p), dot(row1, p), dot(row2, p));
    v_normal = vec3(dot(row0.xyz, normal), dot(row1.xyz, normal), dot(row2.xyz, normal));
    v_rgba = rgba;
    gl_Position = vec4(projection.x * q.x + projection.y * q.z,
                       projection.z * q.y + projection.w * q.z,
                       depth_range.x * q.z - depth_range.y, q.z);
}
"""

MESH_FRAGMENT = """
#version 330
uniform vec3 to_sun;       // optical frame
uniform vec2 light;        // ambient, diffuse
in vec3 v_normal;
flat in vec4 v_rgba;
out vec4 colour;
void main() {
    float cosine = dot(normalize(v_normal), to_sun);
    colour = vec4(v_rgba.rgb * (light.x + light.y * max(cosine, 0.0)), v_rgba.a);
}
"""
