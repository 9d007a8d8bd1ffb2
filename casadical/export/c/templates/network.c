@name@_status @name@_@function@(const @name@_real q[@NAME@_JOINTS], @name@_real @out@[@n_out@])
{
    @name@_status status;
    if ((q == NULL) || (@out@ == NULL))
    {
        status = @NAME@_NULL_ARG;
    }
    else
    {
        static const @name@_real box[2][@NAME@_JOINTS] = @box_table:network@;
        @name@_real x[@NAME@_JOINTS];
        status = @name@_boxed(q, box, x);
        if ((@name@_@function@_values(x, @out@) == 0U) || (status == @NAME@_NOT_FINITE))
        {
            uint32_t i;
            for (i = 0U; i < @n_out@U; i++)
            {
                @out@[i] = @0@;
            }
            status = @NAME@_NOT_FINITE;
        }
    }
    return status;
}

