// Root: nothing has been seen yet in the tiles that are drawn. All else stays as if something were right before the lens, so that
// no fragment there passes the depth test, and keeps what it showed.
layout(location = 0) out uvec4 id;

void main()
{
    id           = uvec4(0u);
    gl_FragDepth = 0.0;   // reversed: infinitely far
}
