@name@_status @name@_network(const @name@_real q[@NAME@_JOINTS], @name@_real dp_mm[@n_dp@])
{
    @name@_status status;
    if ((q == NULL) || (dp_mm == NULL))
    {
        status = @NAME@_NULL_ARG;
    }
    else
    {
        static const @name@_real box[2][@NAME@_JOINTS] = @box_table:network@;
        @name@_real x[@NAME@_JOINTS];
        status = @name@_boxed(q, box, x);
        if ((@name@_network_values(x, dp_mm) == 0U) || (status == @NAME@_NOT_FINITE))
        {
            uint32_t i;
            for (i = 0U; i < @n_dp@U; i++)
            {
                dp_mm[i] = @0@;
            }
            status = @NAME@_NOT_FINITE;
        }
    }
    return status;
}

