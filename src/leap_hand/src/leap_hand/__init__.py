"""From the fingers over the Leap Motion to commands of the ReFlex hand."""
